"""Calibrated tests that do not begin where, by their campaign, the test before them ended."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.messages import Message
from mfd_bayes.population.bands import Forecast
from mfd_bayes.runs.findings import Finding
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]

DRAWS = 1000
"""Draws of the start of each test that are compared."""

LEAST = 0.2
"""Least distance of the two, as a share of the gap. Intervals are narrower than the model is right
in the gap: on real tests a start moved by 0.1 when the test was pooled with the others."""

INTERVAL = (0.025, 0.5, 0.975)


def contradicted_starts(run: Run) -> list[Finding]:
    """A warning for every calibrated test whose start contradicts the end of the one before.

    The start of each test is inferred from its own force. Where its 95 % interval and that of the
    end of the test before do not overlap, one of the two is wrong, or the device was moved.
    """
    found = []
    for name, after in run.manifest.settings.order.items():
        test = run.tests.get(name)
        if test is None or after not in run.tests or "start" not in test.posterior.names:
            continue
        told = [tuple(np.quantile(draws, INTERVAL)) for draws in _places(run, name)]
        (low, middle, high), (lowest, ended, highest) = told
        apart = low > highest or high < lowest
        if apart and abs(middle - ended) >= LEAST:
            sentence = (
                f"the test begins at {middle:.2f} [{low:.2f}, {high:.2f}] of its gap (0: slip "
                f"backward, 1: slip forward), but test {after} ended at {ended:.2f} "
                f"[{lowest:.2f}, {highest:.2f}]: check whether the device was reset or moved in "
                "between"
            )
            found.append(
                Finding(
                    name, "start in the gap", Message("{text}", {"text": sentence}), stage="results"
                )
            )
    return found


def _places(run: Run, name: str) -> tuple[Array, Array]:
    """Draws of the place in the gap where a test begins, and of where the one before ended."""
    test = run.tests[name]
    model, trace = test.posterior.model, test.trace
    before = run.order.before(name, trace, Forecast(draws=DRAWS))
    values = run.order.values(name)
    own = values["start"], model.theta(values)
    expected = own[0] if before is None else before.starts(model, own[1], trace, 0)
    # the place of a start is the start of a place: both count along the first direction
    return model.start_at(own[0], trace), model.start_at(expected, trace)
