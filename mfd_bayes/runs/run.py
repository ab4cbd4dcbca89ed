"""A finished calibration, opened from its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.prior_files import PriorFile, load_priors
from mfd_bayes.calibration.result import TestResult, load_result
from mfd_bayes.errors import StoreError
from mfd_bayes.jobs.job import State
from mfd_bayes.population.population import Population
from mfd_bayes.population.predict import Band, Forecast, Predictor
from mfd_bayes.population.setting import SAME_LEVEL, same_level
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import (
    POPULATION,
    PRIORS,
    check_links,
    check_stored,
    posterior_of,
    record_of,
)
from mfd_bayes.runs.manifest import Manifest, read_manifest
from mfd_bayes.runs.verdict import Verdict
from mfd_bayes.store.netcdf import load_trace

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Run:
    """A run folder.

    Attributes
    ----------
    tests : mapping of str to TestResult
        Calibrated tests.
    held_out : mapping of str to Trace
        Tests with role "validate".
    """

    folder: Path
    manifest: Manifest
    priors: PriorFile
    tests: Mapping[str, TestResult]
    held_out: Mapping[str, Trace]

    @cached_property
    def population(self) -> Population:
        """Laws and scatter across tests."""
        from mfd_bayes.population.storage import load_population

        path = check_stored(self.folder, POPULATION, self.manifest.files or {})
        return load_population(path, self.priors)

    @cached_property
    def offset(self) -> float:
        """Median over the calibrated tests of the median offset of the force, kip."""
        return float(
            np.median([np.median(t.stored.values()["offset"]) for t in self.tests.values()])
        )

    @property
    def hashed(self) -> bool:
        """Whether the manifest has hashes of the stored files, so that changes are detected."""
        return bool(self.manifest.files)

    def rewrite(self, **parts: Any) -> Run:
        """The run with changed keys in its manifest; the manifest is written."""
        manifest = self.manifest.changed(**parts)
        manifest.write(self.folder)
        return replace(self, manifest=manifest)

    @property
    def actuation_unit(self) -> str:
        """The unit of actuation, "ksi" or "kip"."""
        return self.manifest.settings.actuation_unit

    def session(self, name: str) -> str:
        """Session of a test, "" where the campaign declares none."""
        return self.manifest.settings.tests[name].session

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
        """Band of the force under any motion and actuation, tested or new.

        Parameters
        ----------
        trace : Trace
            With its actuation, in `actuation_unit`.
        kind : {"device", "new_test", "observation"}
            What the band includes: the calibrated parameters' uncertainty; also test-to-test
            scatter; also the record's offset and noise.
        probability : float
            Probability of the equal-tailed band at each sample.
        draws, seed : int
        session : str
            Session of the test, where the campaign declares sessions.

        Returns
        -------
        Band
            lower, median, upper (T,) and draws (n, T), kip.

        Raises
        ------
        FitError
            When the trace has no actuation, or kind or probability is invalid.
        """
        forecast = Forecast(kind, probability, draws, seed, session)
        some = next(iter(self.tests.values())).posterior
        at_level = self._at_level(trace) if kind == "device" else None
        band = Predictor(self.population, some.model, some.noise).predict(trace, forecast, at_level)
        return replace(band, remarks=self._remarks(trace))

    def _remarks(self, trace: Trace) -> tuple[str, ...]:
        """Reasons to trust a prediction less than its band suggests."""
        remarks = []
        tested = [test.trace.reference_actuation for test in self.tests.values()]
        asked = np.atleast_1d(trace.actuation)
        low, high = float(np.min(asked)), float(np.max(asked))
        if low < min(tested) * (1 - SAME_LEVEL) or high > max(tested) * (1 + SAME_LEVEL):
            unit = "psi" if self.actuation_unit == "ksi" else "lbf"
            span = " to ".join(f"{1000 * x:.4g}" for x in dict.fromkeys((low, high)))
            remarks.append(
                f"the actuation, {span} {unit}, lies outside the tested range, "
                f"{1000 * min(tested):.4g} to {1000 * max(tested):.4g} {unit}: "
                "there the band relies only on the form of the laws"
            )
        verdicts = self.manifest.verdicts
        if verdicts.get("campaign") == Verdict.FAIL:
            remarks.append(f"the run did not pass its checks: {verdicts.get('sentence', '')}")
        return tuple(remarks)

    def _at_level(self, trace: Trace) -> dict[str, Array] | None:
        """Draws of the tests at this constant actuation, equally many from each, or None."""
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
        When the folder is no finished run, or a file in it is not what the run wrote.
    """
    folder = Path(folder)
    check_links(folder)
    manifest = read_manifest(folder)
    digests = manifest.files or {}
    priors = load_priors(check_stored(folder, PRIORS, digests).name, folder)
    tests, held_out = {}, {}
    for test_id, entry in manifest.tests.items():
        if entry.role == "validate":
            path = check_stored(folder, record_of(test_id), digests)
            held_out[test_id] = load_trace(path)[0]
        elif entry.status == State.DONE:
            path = check_stored(folder, posterior_of(test_id), digests)
            tests[test_id] = load_result(test_id, path, priors)
    if not tests:
        raise StoreError(f"the run in {folder} has no calibrated test")
    return Run(folder, manifest, priors, tests, held_out)
