"""The setting of a test: the conditions under which it was made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mfd_bayes.errors import FitError
from mfd_bayes.records.numbers import real_number
from mfd_bayes.records.trace import Trace, check_trace

SAME_LEVEL = 0.01
"""Tests whose actuation differs by less than this share are at one level."""

_UNITS = {"actuation": "ksi or kip", "velocity": "in/s", "amplitude": "in"}


@dataclass(frozen=True)
class Setting:
    """Conditions of a test.

    Attributes
    ----------
    actuation : float, ksi or kip
    session : str
        Tests of one session were made together; "" where none is declared.
    covariates : mapping of str to float
        What parameters may follow besides the actuation: "velocity" (in/s, its peak) and
        "amplitude" (in, half the stroke).
    """

    actuation: float
    session: str = ""
    covariates: Mapping[str, float] = field(default_factory=dict)


def setting_of(trace: Trace, session: str = "") -> Setting:
    """Setting under which a trace was made, or is to be predicted.

    Raises
    ------
    FitError
        When it is no trace, or has no actuation.
    """
    check_trace("trace", trace, FitError)
    if not np.isfinite(trace.reference_actuation):
        raise FitError("a prediction needs the trace's actuation, in ksi (pressure) or kip (force)")
    covariates = {
        "velocity": float(np.quantile(np.abs(trace.velocity), 0.98)),
        "amplitude": 0.5 * float(np.ptp(trace.displacement)),
    }
    return Setting(trace.reference_actuation, session, covariates)


def planned_setting(
    tested: Sequence[Setting],
    actuation: float,
    session: str,
    planned: Mapping[str, float | None],
) -> Setting:
    """Setting of a test before it is made.

    Parameters
    ----------
    tested : sequence of Setting
        Their geometric means stand for covariates that are not planned.
    actuation : float, ksi or kip
    session : str
    planned : mapping of str to float or None
        Covariates.

    Raises
    ------
    FitError
        When the actuation is no number, 0 or more, or a covariate is no number above zero.
    """
    level = _planned("actuation", actuation, least="0 or more")
    covariates = {}
    for name, value in planned.items():
        known = [s.covariates[name] for s in tested if s.covariates.get(name, 0.0) > 0.0]
        usual = float(np.exp(np.mean(np.log(known)))) if known else 1.0
        covariates[name] = usual if value is None else _planned(name, value)
    return Setting(level, session, covariates)


def _planned(name: str, value: float, least: str = "above zero") -> float:
    """What is planned of a test, checked."""
    try:
        return real_number(name, value, FitError, (0.0, np.inf), inside=least == "above zero")
    except FitError as error:
        sentence = f"the planned {name} must be {least}, in {_UNITS[name]}, got {value!r}"
        raise FitError(sentence) from error


def same_level(actuation: float, other: float) -> bool:
    """Whether two actuations are at one level."""
    return abs(actuation - other) <= SAME_LEVEL * max(actuation, other)


def levels_of(settings: Sequence[Setting]) -> list[list[int]]:
    """Indices of the tests at each level of actuation, lowest level first."""
    folds: list[list[int]] = []
    for j in np.argsort([setting.actuation for setting in settings]).tolist():
        if folds and same_level(settings[folds[-1][0]].actuation, settings[j].actuation):
            folds[-1].append(j)
        else:
            folds.append([j])
    return folds
