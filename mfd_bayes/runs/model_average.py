"""One prediction by several models: each draw of the band belongs to one of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from mfd_bayes.errors import FitError
from mfd_bayes.population.bands import FEWEST, Band, Forecast
from mfd_bayes.population.given import Conditioned
from mfd_bayes.population.settings import THIS_TEST
from mfd_bayes.records.inputs import MOST_DRAWS, whole_number
from mfd_bayes.records.trace import Trace, check_trace
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
        given = self.runs
        several = isinstance(given, Iterable) and not isinstance(given, str | bytes | Mapping)
        runs = tuple(given) if several else ()
        wrong = [run for run in runs if not (hasattr(run, "tests") and hasattr(run, "predict"))]
        if not several or wrong:
            got = repr(wrong[0]) if wrong else type(given).__name__
            raise FitError(f"runs must be two or more runs, as open_run opens them, got {got}")
        object.__setattr__(self, "runs", runs)
        if len(runs) < 2:
            raise FitError(f"an average of models needs at least two runs, got {len(runs)}")
        for first, second in pairwise(runs):
            _check_same_records(first, second)
        twice = [name for name in self.models if self.models.count(name) > 1]
        if twice:
            raise FitError(
                f"two of the runs have the model {twice[0]}: an average of models needs others"
            )

    @property
    def models(self) -> tuple[str, ...]:
        """Model of each run, with its noise where two of them have the same model."""
        settings = [run.manifest.settings for run in self.runs]
        names = [own.model for own in settings]
        if len(set(names)) == len(names):
            return tuple(names)
        return tuple(f"{own.model} ({own.noise})" for own in settings)

    def predict(
        self,
        trace: Trace,
        kind: str = "new_test",
        probability: float = 0.95,
        *,
        draws: int = 500,
        seed: int = 0,
        session: str = "",
        whole: bool = False,
        given: tuple[float, float] | None = None,
        after: str = "",
    ) -> Band:
        """Band of the force under any motion and actuation, by all models together.

        Parameters
        ----------
        trace, kind, probability, seed, session, whole, given, after
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
        check_trace("trace", trace, FitError)
        n = len(self.runs)
        whole_number(f"draws (of {n} runs together)", draws, FEWEST * n, FitError, MOST_DRAWS)
        options: dict[str, Any] = {"seed": seed, "session": session, "given": given, "after": after}
        bands = {
            model: run.predict(
                trace, kind, probability, draws=draws // n + (i < draws % n), **options
            )
            for i, (model, run) in enumerate(zip(self.models, self.runs, strict=True))
        }
        forecast = Forecast(kind, probability, draws, seed, session, whole)
        together = np.concatenate([band.draws for band in bands.values()])
        return replace(
            Band.of(trace.time, together, forecast, _source(bands)),
            remarks=_remarks(bands),
            given=_worst_given([band.given for band in bands.values() if band.given]),
            extras=self.runs[0].extras,
        )


def _check_same_records(first: Run, second: Run) -> None:
    """Refuse runs that were not calibrated with the same records."""
    for run, other in ((first, second), (second, first)):
        missing = [name for name in run.tests if name not in other.tests]
        if missing:
            raise FitError(
                f"test {missing[0]!r} is calibrated in {run.folder} but not in {other.folder}: "
                "an average of models needs runs of the same tests"
            )
    for name, test in first.tests.items():
        other_test = second.tests[name]
        if not np.array_equal(np.asarray(test.trace.force), np.asarray(other_test.trace.force)):
            raise FitError(
                f"the record of test {name!r} is another in {first.folder} than in "
                f"{second.folder}: an average of models needs runs of the same records"
            )


def _source(bands: Mapping[str, Band]) -> str:
    """Where the parameters come from."""
    sources = {band.source for band in bands.values()}
    if len(sources) == 1:
        return f"{_listed(list(bands))} in equal parts, {sources.pop()}"
    return "equal parts of " + _listed([f"{name}, {b.source}" for name, b in bands.items()])


def _listed(words: Sequence[str]) -> str:
    """Words with commas, and "and" before the last."""
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _remarks(bands: Mapping[str, Band]) -> tuple[str, ...]:
    """Remarks of all bands, once each, and where the models disagree."""
    remarks = tuple(dict.fromkeys(remark for band in bands.values() for remark in band.remarks))
    medians = np.array([band.median for band in bands.values()])
    distance = float(np.sqrt(np.mean(np.var(medians, axis=0)))) * 2.0
    half = float(np.mean([np.mean(band.upper - band.lower) for band in bands.values()])) / 2.0
    if distance <= DISAGREEMENT * half:
        return remarks
    share = 100.0 * distance / half
    return (
        *remarks,
        f"the models disagree: their medians are apart by {share:.0f} % of half the width of "
        "one model's band (root mean square), and tests do not yet tell which one is right here",
    )


def _worst_given(parts: Sequence[Conditioned]) -> Conditioned | None:
    """How all models together took the given part in: by the worst of them."""
    if not parts:
        return None
    return Conditioned(
        parts[0].window,
        max(part.samples for part in parts),
        max(part.pareto_k for part in parts),
        "sampling" if any(part.method == "sampling" for part in parts) else "weights",
        sum(part.effective for part in parts),
        max(part.stages for part in parts),
    )
