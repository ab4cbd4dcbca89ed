"""The friction models that a campaign can name: a new one is registered here, by one line."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from mfd_bayes.errors import FitError
from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.three_stage import ThreeStage

MODELS: Mapping[str, Model] = MappingProxyType(
    {model.name: model for model in (ThreeStage(), LuGre(), BoucWen(), BacklashLuGre())}
)
"""Every model by its name in campaign files."""


def find_model(name: str) -> Model:
    """Model of that name.

    Raises
    ------
    FitError
        When there is none; the names that there are are listed.
    """
    if not (isinstance(name, str) and name in MODELS):
        raise FitError(f"unknown model {name!r}: expected one of {', '.join(MODELS)}")
    return MODELS[name]
