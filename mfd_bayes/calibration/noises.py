"""The noises that a campaign can name: a new one is registered here, by one line."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from mfd_bayes.calibration.noise import OU, Noise, StudentT
from mfd_bayes.calibration.staged_noise import Staged
from mfd_bayes.errors import FitError

NOISES: Mapping[str, Noise] = MappingProxyType(
    {
        noise.name: noise
        for noise in (
            OU(),
            Noise(),
            StudentT(),
            Staged(),
        )
    }
)
"""Every noise by its name in campaign files."""


def find_noise(name: str) -> Noise:
    """Noise of that name.

    Raises
    ------
    FitError
        When there is none; the names that there are are listed.
    """
    if not isinstance(name, str) or name not in NOISES:
        raise FitError(f"unknown noise {name!r}: expected one of {', '.join(NOISES)}")
    return NOISES[name]
