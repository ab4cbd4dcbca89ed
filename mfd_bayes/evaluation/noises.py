"""What a test's quantities are under other noises, and where the choice of the noise decides."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise_sensitivity import HALF, Bounds, moves, quantiles_of
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.quantities import units
from mfd_bayes.evaluation.views import NOISE, Check, NoiseRow, Row, TestView
from mfd_bayes.messages import Message
from mfd_bayes.runs.findings import Finding
from mfd_bayes.runs.verdict import Verdict

Array = NDArray[np.float64]

_FIRST = ("gap", "k3", "k2", "Fs_fwd", "Fs_bwd")
"""Quantities that matter most in design come first, after the slip forces."""

_NAMED = 3
"""Most quantities of a test that a warning tells of with their values."""


def noise_rows(
    test: str, posterior: Posterior, values: Mapping[str, Array], facts: Mapping[str, Any]
) -> tuple[NoiseRow, ...]:
    """Every quantity of a test under its own noise and under others; empty where not checked.

    Parameters
    ----------
    values : mapping of str to (n,)
        Posterior draws of all quantities.
    facts : mapping
        Stored facts of the test.
    """
    fits = [fit for fit in facts.get("other_noises", ()) if fit["quantities"]]
    if not fits:
        return ()
    known = units() | {"gap": "in"}
    own = quantiles_of(posterior, values)
    noise = posterior.noise.name
    return tuple(
        _row((test, name, known[name], noise), own[name], fit["noise"], fit["quantities"][name])
        for fit in fits
        for name in _ordered(posterior, own)
        if name in fit["quantities"] and None not in fit["quantities"][name]
    )


def _row(
    head: tuple[str, str, str, str], own: Bounds, noise: str, other: Sequence[float]
) -> NoiseRow:
    low, middle, high = other
    return NoiseRow(*head, *own, noise, low, middle, high, moves(own, other))


def _ordered(posterior: Posterior, names: Iterable[str]) -> list[str]:
    first = (*posterior.model.slip_forces, *_FIRST)
    return sorted(names, key=lambda name: first.index(name) if name in first else len(first))


def with_others(rows: Iterable[Row], noises: Sequence[NoiseRow]) -> list[Row]:
    """Rows of parameters, each with its values under the noises that decide it."""
    return [
        replace(row, others=tuple(n for n in noises if n.decides and n.name == row.name))
        for row in rows
    ]


def noise_checks(test: str, noises: Sequence[NoiseRow], facts: Mapping[str, Any]) -> list[Check]:
    """Checks that cannot fail: a note for every quantity that another noise moves."""
    found = [_check(row) for row in noises if row.decides]
    for fit in facts.get("other_noises", ()):
        own = [row for row in noises if row.other == fit["noise"]]
        if fit["error"]:
            target = f"no fit with {fit['noise']}: {fit['error']}"
            found.append(Check(test, NOISE, target, np.nan, "fitted", Verdict.NOTE))
        elif own and not any(row.decides for row in own):
            target = f"all {len(own)} quantities with {fit['noise']}"
            largest = max(_shift(row) for row in own)
            found.append(Check(test, NOISE, target, largest, _LIMIT, Verdict.PASS))
    return found


_LIMIT = f"moves by {HALF:g} of its 95 % interval at most, and intervals overlap"


def _check(row: NoiseRow) -> Check:
    target = f"{told(row)}: the noise model decides"
    return Check(row.subject, NOISE, target, _shift(row), _LIMIT, Verdict.NOTE)


def _shift(row: NoiseRow) -> float:
    """By how much the median moves, in 95 % intervals."""
    return abs(row.other_median - row.median) / (row.upper - row.lower)


def told(row: NoiseRow) -> str:
    """A quantity under both noises: "k3 is 26 [23.9, 29] kip/in with ou, 42.2 [39, 45.6] …"."""
    own = f"{row.median:.3g} [{row.lower:.3g}, {row.upper:.3g}]"
    other = f"{row.other_median:.3g} [{row.other_lower:.3g}, {row.other_upper:.3g}]"
    unit = "" if row.unit in ("1", "dimensionless") else f" {row.unit}"
    return f"{row.name} is {own}{unit} with {row.noise}, {other}{unit} with {row.other}"


def noise_sentence(rows: Iterable[NoiseRow]) -> str:
    """The quantities of a test that the noise decides, the first with their values; "" if none."""
    decided = [row for row in rows if row.decides]
    by_name: dict[str, NoiseRow] = {}
    for row in decided:
        held = by_name.setdefault(row.name, row)
        if _shift(row) > _shift(held):
            by_name[row.name] = row
    names = list(by_name)
    if not names:
        return ""
    words = "; ".join(told(by_name[name]) for name in names[:_NAMED])
    more = f"; also {', '.join(names[_NAMED:])}" if names[_NAMED:] else ""
    return f"{words}: the noise model decides{more}"


def noise_findings(tests: Iterable[TestView]) -> list[Finding]:
    """A warning for each test of which the noise decides some quantity."""
    told_of = ((test.id, noise_sentence(test.noises)) for test in tests)
    return [
        Finding(name, NOISE, Message("{text}", {"text": words}), stage="results")
        for name, words in told_of
        if words
    ]


def unchecked(tests: Iterable[TestView]) -> str:
    """Sentence on calibrated tests that were not fitted under another noise; "" if none."""
    left = [test.id for test in tests if test.rows and not test.noises]
    if not left:
        return ""
    which = ", ".join(left[:_NAMED]) + (f" and {len(left) - _NAMED} more" if left[_NAMED:] else "")
    return (
        f"Not fitted under another noise model: {which}. How far their parameters depend on that "
        "choice is not known. The effort standard does it; at quick, noise_check = true in "
        "[campaign] asks for it."
    )
