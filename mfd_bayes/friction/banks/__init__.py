"""Banks of dampers, each with its own parameters and its own motion, stepped together in time."""

from __future__ import annotations

from numpy.typing import ArrayLike

from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.friction.banks.backlash import BacklashBank
from mfd_bayes.friction.banks.bank import Array, Bank
from mfd_bayes.friction.banks.hysteresis import HystereticBank
from mfd_bayes.friction.banks.one_by_one import OneByOne
from mfd_bayes.friction.banks.paper import PaperBank
from mfd_bayes.friction.banks.plastic import PlasticBank
from mfd_bayes.friction.banks.weakened import WeakenedBank
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.paper import PaperModel
from mfd_bayes.friction.weakened import Weakened

__all__ = [
    "BacklashBank",
    "Bank",
    "HystereticBank",
    "OneByOne",
    "PaperBank",
    "PlasticBank",
    "WeakenedBank",
    "bank_of",
]


def bank_of(
    model: Model, theta: ArrayLike, start: ArrayLike | None = None, direction: Array | None = None
) -> Bank:
    """Bank of dampers of a model, at rest at displacement 0.

    Parameters
    ----------
    model : Model
        One with `start` and `step`. Models that have no bank of their own are stepped damper by
        damper, which is right and slow.
    theta : (n, p)
        Parameters of each damper.
    start : (n,), optional
        Place of each in its gap; ½ when left out.
    direction : (n,), optional
        ±1, direction of each one's first motion, where it is known; what a damper holds at rest
        inside its gap depends on it.

    Raises
    ------
    FitError
        When a shape or a value does not fit, or the model cannot be stepped in time.
    """
    if isinstance(model, PaperModel):
        return PaperBank.at_rest(model, theta, start, direction)
    if isinstance(model, BoucWen):
        return HystereticBank.at_rest(model, theta)
    if isinstance(model, BacklashLuGre):
        return BacklashBank.at_rest(model, theta, start)
    if isinstance(model, Weakened):
        own, weakening = model.parts(theta)
        without = bank_of(model.base, own, start, direction)
        return WeakenedBank.at_rest(model, without, weakening, direction)
    return OneByOne.at_rest(model, theta, start, direction)
