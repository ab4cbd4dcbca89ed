"""The beginning of a record that a fit leaves out, where the place in the gap is not known."""

from __future__ import annotations

import itertools

from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import Model
from mfd_bayes.records.trace import Trace


def first_slip(trace: Trace, file: PriorFile, model: Model) -> int:
    """Sample from which the device has surely slipped: after a stretch of two prior gaps.

    Raises
    ------
    FitError
        When the priors have no gap, or no stretch of the record is that long.
    """
    gap = file.gap
    if gap is None and not model.has_gap:
        return 0
    if gap is None:
        raise FitError(
            f"start = 'mask' needs the width of the gap: {file.path.name} has no priors of d2 and "
            "d3, and none of gap"
        )
    for begin, end in itertools.pairwise([0, *trace.turning_points.tolist()]):
        if abs(trace.displacement[end] - trace.displacement[begin]) >= 2.0 * gap:
            return int(end)
    raise FitError(
        "start = 'mask' needs a record that goes on after a stroke of twice the prior's gap: what "
        "comes before is not fitted"
    )
