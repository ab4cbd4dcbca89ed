"""By how much a model may miss a figure of a test before a verdict says so."""

from __future__ import annotations

from collections.abc import Mapping

DEFAULTS: Mapping[str, float] = {
    "energy": 0.05,
    "peak": 0.15,
    "residual": 0.3,
    "correlation": 0.2,
    "mid_gap": 0.1,
    "coverage": 0.1,
    "slip_force": 0.1,
    "build_up": 0.3,
    "gap": 0.15,
}
"""Shares: of the measured energy, peak force and rms residual; of one for the correlation of
residuals; of the measured half range for the force at mid-gap; of all samples for coverage, by
which too few lie inside a band; of the reading off the loop for slip force, build-up and gap."""


def complete_tolerances(given: Mapping[str, float] | None) -> dict[str, float]:
    """Every tolerance, as given or by default."""
    return {**DEFAULTS, **(given or {})}
