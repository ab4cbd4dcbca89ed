"""A calibrated test, as it is stored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mfd_bayes.calibration.extras import Extras, needed
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.shown import HEAD, Interval, interval_rows, intervals_of
from mfd_bayes.calibration.stored import check_draws, check_facts
from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.records.regular import hash_file
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.cards import grid
from mfd_bayes.store.netcdf import StoredTest, load_test

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False)
class TestResult:
    """A calibrated test.

    Attributes
    ----------
    id : str
    posterior : Posterior
    path : Path
        Of the stored posterior.
    sha256 : str
        Of that file, where it is known: the draws of another run are not taken for this one's.
    intervals : mapping of str to (float, float, float)
        Median and equal-tailed 95 % interval of every quantity: 50, 2.5 and 97.5 %.
    """

    __test__ = False

    id: str
    posterior: Posterior
    path: Path
    sha256: str = ""
    intervals: Mapping[str, Interval] = field(default_factory=dict, repr=False)
    extras: Extras | None = field(default=None, repr=False)

    def plot_loops(self, axes: Any = None) -> Any:
        """Matplotlib axes with the measured loops over the bands of a measurement, as replicated.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Raises
        ------
        FitError
            When the test does not come from a run of `mfd_bayes.open_run`.
        """
        return needed(self.extras).plot_loops(self, axes)

    def inference_data(self) -> Any:
        """What ArviZ's functions take: InferenceData, or a DataTree from ArviZ 1 on.

        Its groups are those of `posterior.nc`, and `log_likelihood`: the log density of each cycle
        given all others, by which `az.loo` leaves out whole cycles. That takes some seconds.

        Raises
        ------
        FitError
            When the test does not come from a run of `mfd_bayes.open_run`, or has fewer cycles
            than can be left out.
        """
        return needed(self.extras).inference_data(self)

    def _repr_html_(self) -> str:
        rows = interval_rows(self.intervals)
        return grid(f"Test {self.id}, {self.posterior.model.name}", HEAD, rows)

    @property
    def stored(self) -> StoredTest:
        """What is stored of it, read anew each time: the draws of many tests are not all held.

        Raises
        ------
        StoreError
            When the file cannot be read, or was replaced since its run was opened.
        """
        if self.sha256 and self.path.is_file() and hash_file(self.path) != self.sha256:
            raise StoreError(f"{self.path} was changed by another process since it was opened")
        return load_test(self.path)

    @property
    def draws(self) -> xr.Dataset:
        """Posterior draws as ArviZ reads them: named variables (chain, draw) with units."""
        return self.stored.draws

    @property
    def trace(self) -> Trace:
        """The record that was fitted."""
        return self.posterior.trace


def load_result(test_id: str, path: Path, priors: PriorFile) -> TestResult:
    """Calibrated test of its stored posterior.

    Raises
    ------
    StoreError
        When the file is missing, or holds no posterior under these priors.
    """
    stored = load_test(path)
    facts = stored.facts
    check_facts(facts, path)
    try:
        posterior = Posterior(
            stored.trace, priors, facts["noise"], facts["model"], start=facts["start"]
        )
    except MfdError as error:
        raise StoreError(f"{path} is damaged or not of this program: {error}") from error
    check_draws(stored, posterior, path)
    return TestResult(test_id, posterior, path, intervals=intervals_of(stored.values()))
