"""A calibrated test as it is stored, checked so that all later results can be computed from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from mfd_bayes.calibration.extras import Extras, needed
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.quantities import Interval, interval_rows, intervals_of
from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.records.regular import hash_file
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.cards import grid
from mfd_bayes.store.netcdf import StoredTest, load_test
from mfd_bayes.store.schema import LARGEST, Figure, Index, Part, Positive, Three, check

if TYPE_CHECKING:
    import xarray as xr

_Share = Annotated[float, Field(ge=0, le=1.001)]


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
        title = f"Test {self.id}, {self.posterior.model.name}"
        return grid(title, *interval_rows(self.intervals))

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


class _OtherFit(Part):
    """A fit under another noise, as `noise_sensitivity.OtherFit` is stored."""

    noise: Annotated[str, Field(max_length=100)]
    how: Annotated[str, Field(max_length=100)]
    k: Figure
    size: Figure
    quantities: dict[str, Three]
    seconds: Figure
    error: str


class _Facts(Part):
    """Facts of a sampling that are read back."""

    model: str
    noise: str
    start: Literal["sample", "mask"]
    walkers: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(le=10**12)]
    discarded: Index
    seed: list[Index]
    modes: Annotated[int, Field(ge=1, le=1000)]
    mode_shares: list[list[_Share]] = Field(default_factory=list, max_length=1000)
    mode_values: list[dict[str, float | None]] = Field(default_factory=list, max_length=1000)
    autocorrelation: Annotated[dict[str, Positive | None], Field(min_length=1)]
    other_noises: list[_OtherFit] = Field(default_factory=list, max_length=20)
    convergence: dict[str, Annotated[list[float | None], Field(min_length=3, max_length=3)]]


def check_facts(facts: Any, where: Path) -> None:
    """Refuse sampling facts that no calibration stores."""
    found = check(_Facts, facts, where)
    if len({len(shares) for shares in found.mode_shares}) > 1:
        raise StoreError(f"{where} is damaged: mode_shares differ in length between chains")


def check_draws(stored: StoredTest, posterior: Posterior, where: Path) -> None:
    """Refuse draws with wrong names or sizes, or outside the support of their priors."""
    level = posterior.trace.reference_actuation
    if not level >= 0:
        raise StoreError(f"{where} must be of a test with an actuation, got {level:g}")
    wanted = {*posterior.names, *posterior.model.parameters, "offset", "start"}
    arrays, stats = stored.posterior.arrays, stored.sample_stats.arrays
    if missing := wanted - set(arrays):
        raise StoreError(f"{where} holds no draws of {min(missing)}")
    if unknown := set(arrays) - wanted - {*posterior.priors, "gamma1"}:
        raise StoreError(
            f"{where} holds draws of {min(unknown)[:60]!r}, which the model does not have"
        )
    densities = ("log_prior", "log_likelihood")
    if not set(densities) <= set(stats):
        raise StoreError(f"{where} holds no {' and '.join(densities)} in its sample_stats")
    shape = arrays["offset"].shape
    for name, values in (arrays | {n: stats[n] for n in densities}).items():
        if values.shape != shape or values.ndim != 2 or values.dtype != np.float64:
            raise StoreError(f"{where} must hold {name} as (chain, draw) numbers like the others")
        if not np.all(np.abs(values) <= LARGEST):
            raise StoreError(f"{where} must hold finite draws of {name}")
    if shape[0] < 1 or shape[1] < 1 or shape[1] % stored.facts["walkers"]:
        raise StoreError(f"{where} must hold draws of {stored.facts['walkers']} walkers")
    for name in wanted & set(posterior.priors):
        prior, values = posterior.priors[name], arrays[name]
        with np.errstate(all="ignore"):
            inside = np.isfinite(prior.log_density(prior.coordinate(values)))
        if not np.all(inside):
            value = values[~inside][0]
            raise StoreError(f"{where} holds a draw of {name}, {value:g}, that its prior excludes")
