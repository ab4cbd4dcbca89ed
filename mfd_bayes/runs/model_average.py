"""Several runs of the same records under other models, averaged."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from mfd_bayes.errors import MOST_DRAWS, FitError, whole_number
from mfd_bayes.population.bands import FEWEST, THIS_TEST, Band, PredictionOptions
from mfd_bayes.population.conditioning import ConditioningSummary
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run

DISAGREEMENT = 0.5
"""Models disagree where their medians are apart by more than this share of half the band's width,
root mean square."""


@dataclass(frozen=True)
class ModelAverage:
    """Runs of the same tests with different models, which predict together.

    Every run gives the same share of the draws: tests of full cycles say little about which model
    is nearer in another motion, so none is preferred. Where the models agree the band is about as
    wide as theirs; where they differ it holds what each of them says.

    Attributes
    ----------
    runs : sequence of Run
        Two or more; kept as a tuple.

    Raises
    ------
    FitError
        When there are fewer than two runs, one is no run, two of them have the same model and
        noise, or not the same calibrated tests.
    """

    runs: Sequence[Run]

    def __post_init__(self) -> None:
        runs = tuple(self.runs) if isinstance(self.runs, Iterable) else (self.runs,)
        if len(runs) < 2 or not all(isinstance(run, Run) for run in runs):
            kinds = ", ".join(type(run).__name__ for run in runs) or "none"
            raise FitError(
                f"an average of models needs two or more runs, as open_run opens them, got {kinds}"
            )
        object.__setattr__(self, "runs", runs)
        for first_run, second_run in pairwise(runs):
            _check_same_records(first_run, second_run)
        twice = [name for name in self.models if self.models.count(name) > 1]
        if twice:
            raise FitError(
                f"two of the runs have the model {twice[0]}: an average of models needs others"
            )

    @property
    def models(self) -> tuple[str, ...]:
        """Model of each run, with its noise where two of them have the same model."""
        settings = [run.manifest.settings for run in self.runs]
        names = [setting.model for setting in settings]
        if len(set(names)) == len(names):
            return tuple(names)
        return tuple(f"{setting.model} ({setting.noise})" for setting in settings)

    def predict(
        self,
        trace: Trace,
        kind: str = "new_test",
        probability: float = 0.95,
        *,
        draws: int = 500,
        seed: int = 0,
        session: str = "",
        simultaneous: bool = False,
        condition_on: tuple[float, float] | None = None,
        after: str = "",
    ) -> Band:
        """Band of the force under any motion and actuation, by all models together.

        Parameters
        ----------
        trace, kind, probability, seed, session, simultaneous, condition_on, after
            As in `Run.predict`; not of kind `this_test`.
        draws : int
            Of all models together, 10 or more for each.

        Returns
        -------
        Band
            lower, median, upper (T,) and draws (n, T), kip. The draws of the first run come first.
            `values` are empty, since each model has its own quantities.

        Raises
        ------
        FitError
            As `Run.predict` does, or when the kind is `this_test`.
        """
        if kind == THIS_TEST:
            raise FitError("an average of models predicts a new test, not the kind this_test")
        n = len(self.runs)
        whole_number(f"draws (of {n} runs together)", draws, FEWEST * n, FitError, MOST_DRAWS)
        options: dict[str, Any] = {
            "seed": seed,
            "session": session,
            "condition_on": condition_on,
            "after": after,
        }
        bands = [
            run.predict(trace, kind, probability, draws=draws // n + (i < draws % n), **options)
            for i, run in enumerate(self.runs)
        ]
        forecast = PredictionOptions(kind, probability, draws, seed, session, simultaneous)
        together = np.concatenate([band.draws for band in bands])
        remarks = dict.fromkeys(remark for band in bands for remark in band.remarks)
        return replace(
            Band.of(trace.time, together, forecast, self._source(bands)),
            remarks=(*remarks, *_disagreement(bands)),
            conditioning=_worst_given([band.conditioning for band in bands if band.conditioning]),
            _backend=self.runs[0]._backend,
        )

    def _source(self, bands: Sequence[Band]) -> str:
        """Where the parameters come from."""
        if len({band.source for band in bands}) == 1:
            return f"{_listed(self.models)} in equal parts, {bands[0].source}"
        sources = [f"{name}, {b.source}" for name, b in zip(self.models, bands, strict=True)]
        return f"equal parts of {_listed(sources)}"


def _check_same_records(first_run: Run, second_run: Run) -> None:
    """Refuse runs that were not calibrated with the same records."""
    folders = f"{first_run.folder} and {second_run.folder}"
    if odd := sorted({*first_run.tests} ^ {*second_run.tests}):
        raise FitError(
            f"test {odd[0]!r} is calibrated in only one of {folders}: an average of models needs "
            "runs of the same tests"
        )
    for name, test in first_run.tests.items():
        force, other_force = (
            np.asarray(result.trace.force) for result in (test, second_run.tests[name])
        )
        if not np.array_equal(force, other_force):
            raise FitError(
                f"the record of test {name!r} is not the same in {folders}: an average of models "
                "needs runs of the same records"
            )


def _listed(words: Sequence[str]) -> str:
    """Words with commas, and "and" before the last."""
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _disagreement(bands: Sequence[Band]) -> list[str]:
    """A remark where the models disagree."""
    medians = np.array([band.median for band in bands])
    distance = float(np.sqrt(np.mean(np.var(medians, axis=0)))) * 2.0
    half = float(np.mean([np.mean(band.upper - band.lower) for band in bands])) / 2.0
    if distance <= DISAGREEMENT * half:
        return []
    return [
        f"the models disagree: their medians are apart by {100.0 * distance / half:.0f} % of half "
        "the width of one model's band (root mean square), and tests do not yet tell which one is "
        "right here"
    ]


def _worst_given(results: Sequence[ConditioningSummary]) -> ConditioningSummary | None:
    """How the worst of the models took the given part in, with the effective draws of all."""
    if not results:
        return None
    worst = max(results, key=lambda result: result.pareto_k)
    return replace(worst, effective=sum(result.effective for result in results))
