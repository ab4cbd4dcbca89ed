"""A finished calibration, opened from its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile, load_priors
from mfd_bayes.errors import StoreError
from mfd_bayes.population.hierarchy import Population
from mfd_bayes.population.pooling import same_level
from mfd_bayes.population.predict import Band, Forecast, predict
from mfd_bayes.records.trace import Trace
from mfd_bayes.store import MANIFEST, StoredTest, load_test, load_trace, read_json

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TestResult:
    """A calibrated test.

    Attributes
    ----------
    id : str
    posterior : Posterior
    stored : StoredTest
    """

    __test__ = False

    id: str
    posterior: Posterior
    stored: StoredTest

    @property
    def draws(self) -> xr.Dataset:
        """Posterior draws as ArviZ reads them: named variables (chain, draw) with units."""
        return self.stored.draws

    @property
    def trace(self) -> Trace:
        """The record that was fitted."""
        return self.stored.trace


@dataclass(frozen=True, eq=False)
class Run:
    """A run folder.

    Attributes
    ----------
    folder : Path
    manifest : dict
    priors : PriorFile
    tests : mapping of str to TestResult
        Calibrated tests.
    held_out : mapping of str to Trace
        Tests with role "validate".
    """

    folder: Path
    manifest: dict[str, Any]
    priors: PriorFile
    tests: Mapping[str, TestResult]
    held_out: Mapping[str, Trace]

    @cached_property
    def population(self) -> Population:
        """Laws and scatter across tests."""
        from mfd_bayes.population.storage import load_population

        return load_population(self.folder / "population.nc", self.priors)

    @property
    def actuation_unit(self) -> str:
        """The unit of actuation, "ksi" or "kip"."""
        return str(self.manifest["settings"]["actuation_unit"])

    def session(self, name: str) -> str:
        """Session of a test, "" where the campaign declares none."""
        return str(self.manifest["settings"]["tests"][name].get("session", ""))

    def predict(
        self,
        trace: Trace,
        kind: str = "new_test",
        probability: float = 0.95,
        *,
        draws: int = 500,
        seed: int = 0,
        session: str = "",
    ) -> Band:
        """Band of the force under a motion and an actuation, seen or not.

        Parameters
        ----------
        trace : Trace
            With its actuation, in `actuation_unit`.
        kind : {"device", "new_test", "observation"}
            The calibrated parameters' uncertainty; plus test-to-test scatter; plus the
            record's offset and noise.
        probability : float
            Of the equal-tailed band at each sample.
        draws, seed : int
        session : str
            That of the test, where the campaign declares sessions.

        Returns
        -------
        Band
            lower, median, upper (T,) and draws (n, T), kip.

        Raises
        ------
        FitError
            When the trace has no actuation, or kind or probability make no sense.
        """
        forecast = Forecast(kind=kind, probability=probability, draws=draws, seed=seed)
        some = next(iter(self.tests.values())).posterior
        return predict(
            self.population, some.model, some.noise, trace, forecast, self._at_level(trace), session
        )

    def _at_level(self, trace: Trace) -> dict[str, Array] | None:
        """Draws of the tests at this constant actuation, in equal number, or None."""
        level = trace.reference_actuation
        near = [
            test.stored.values()
            for test in self.tests.values()
            if not (trace.varying or test.trace.varying)
            and same_level(test.trace.reference_actuation, level)
        ]
        if not near:
            return None
        fewest = min(len(values["offset"]) for values in near)
        picks = [np.linspace(0, len(v["offset"]) - 1, fewest).astype(np.intp) for v in near]
        return {
            name: np.concatenate([v[name][pick] for v, pick in zip(near, picks, strict=True)])
            for name in near[0]
        }


def open_run(folder: str | Path) -> Run:
    """Finished calibration of a run folder.

    Raises
    ------
    StoreError
        When the folder is no finished run.
    """
    folder = Path(folder)
    if not (folder / MANIFEST).is_file():
        raise StoreError(f"{folder} is not a run folder: it has no {MANIFEST}")
    manifest = read_json(folder / MANIFEST)
    if manifest.get("status") != "finished":
        raise StoreError(f"the run in {folder} is not finished; finish it with --resume")
    priors = load_priors("priors.toml", folder)
    tests, held_out = {}, {}
    for test_id, entry in manifest["tests"].items():
        home = folder / "tests" / test_id
        if entry["role"] == "validate":
            held_out[test_id] = load_trace(home / "record.nc")[0]
        elif entry["status"] == "done":
            tests[test_id] = load_result(test_id, home / "posterior.nc", priors)
    return Run(folder, manifest, priors, tests, held_out)


def load_result(test_id: str, path: Path, priors: PriorFile) -> TestResult:
    """Calibrated test of its stored posterior."""
    stored = load_test(path)
    facts = stored.facts
    posterior = Posterior(
        stored.trace, priors, facts["noise"], facts["model"], start=facts["start"]
    )
    return TestResult(test_id, posterior, stored)
