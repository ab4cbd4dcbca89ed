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
from mfd_bayes.friction.weakened import Weakened
from mfd_bayes.friction.weakening import ENDINGS

MODELS: Mapping[str, Model] = MappingProxyType(
    {
        model.name: model
        for model in (
            ThreeStage(),
            LuGre(),
            BoucWen(),
            BacklashLuGre(),
        )
    }
)
"""Every model by its name in campaign files."""


def every_name() -> tuple[str, ...]:
    """Names of all models, each also with what may follow it, in the program's order."""
    return tuple(n for base in MODELS for n in (base, *(f"{base}+{end}" for end in ENDINGS)))


def find_model(name: str) -> Model:
    """Model of that name; with "+weakening" after it, one whose friction falls after a turn.

    Raises
    ------
    FitError
        When there is none; the names that there are are listed.
    """
    base, plus, ending = name.partition("+") if isinstance(name, str) else ("", "", "")
    if base not in MODELS or (plus and ending not in ENDINGS):
        raise FitError(f"unknown model {name!r}: expected one of {', '.join(MODELS)}")
    return Weakened(MODELS[base], ENDINGS[ending]) if plus else MODELS[base]
