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
from mfd_bayes.records.numbers import MOST_DRAWS, whole_number
from mfd_bayes.records.trace import Trace, check_trace
from mfd_bayes.runs.run import Run

APART = 0.5
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
        object.__setattr__(self, "runs", _checked(self.runs))
        if len(self.runs) < 2:
            raise FitError(f"an average of models needs at least two runs, got {len(self.runs)}")
        for one, other in pairwise(self.runs):
            _check_same(one, other)
        twice = [name for name in self.models if self.models.count(name) > 1]
        if twice:
            raise FitError(
                f"two of the runs have the model {twice[0]}: an average of models needs others"
            )

    @property
    def models(self) -> tuple[str, ...]:
        """Model of each run, with its noise where two of them have the same model."""
        settings = [run.manifest.settings for run in self.runs]
        names = [one.model for one in settings]
        if len(set(names)) == len(names):
            return tuple(names)
        return tuple(f"{one.model} ({one.noise})" for one in settings)

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
        least = FEWEST * len(self.runs)
        whole_number(
            f"draws (of {len(self.runs)} runs together)", draws, least, FitError, MOST_DRAWS
        )
        forecast = Forecast(kind, probability, draws, seed, session, whole)
        bands = [
            run.predict(
                trace,
                kind,
                probability,
                draws=share,
                seed=seed,
                session=session,
                given=given,
                after=after,
            )
            for run, share in zip(self.runs, _shares(draws, len(self.runs)), strict=True)
        ]
        named = dict(zip(self.models, bands, strict=True))
        return replace(
            Band.of(trace.time, np.concatenate([b.draws for b in bands]), forecast, _source(named)),
            remarks=_remarks(named),
            given=_given([band.given for band in bands if band.given]),
            extras=self.runs[0].extras,
        )


_NEEDED = ("tests", "manifest", "predict")


def _checked(runs: Any) -> tuple[Run, ...]:
    """The runs, when they are some."""
    several = isinstance(runs, Iterable) and not isinstance(runs, str | bytes | Mapping)
    found = tuple(runs) if several else ()
    wrong = [one for one in found if not all(hasattr(one, name) for name in _NEEDED)]
    if not several or wrong:
        got = repr(wrong[0]) if wrong else type(runs).__name__
        raise FitError(f"runs must be two or more runs, as open_run opens them, got {got}")
    return found


def _check_same(one: Run, other: Run) -> None:
    """Refuse runs that were not calibrated with the same records."""
    for run, than in ((one, other), (other, one)):
        missing = [name for name in run.tests if name not in than.tests]
        if missing:
            raise FitError(
                f"test {missing[0]!r} is calibrated in {run.folder} but not in {than.folder}: "
                "an average of models needs runs of the same tests"
            )
    for name, test in one.tests.items():
        if not np.array_equal(
            np.asarray(test.trace.force), np.asarray(other.tests[name].trace.force)
        ):
            raise FitError(
                f"the record of test {name!r} is another in {one.folder} than in {other.folder}: "
                "an average of models needs runs of the same records"
            )


def _shares(draws: int, n: int) -> list[int]:
    """Draws of each run, whose numbers differ by one at most."""
    return [draws // n + (i < draws % n) for i in range(n)]


def _source(named: Mapping[str, Band]) -> str:
    """Where the parameters come from."""
    sources = {band.source for band in named.values()}
    names = _listed(list(named))
    if len(sources) == 1:
        return f"{names} in equal parts, {sources.pop()}"
    return "equal parts of " + _listed([f"{name}, {b.source}" for name, b in named.items()])


def _listed(words: Sequence[str]) -> str:
    """Words with commas, and "and" before the last."""
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _remarks(named: Mapping[str, Band]) -> tuple[str, ...]:
    """Remarks of all bands, once each, and where the models disagree."""
    said = tuple(dict.fromkeys(remark for band in named.values() for remark in band.remarks))
    medians = np.array([band.median for band in named.values()])
    apart = float(np.sqrt(np.mean(np.var(medians, axis=0)))) * 2.0
    half = float(np.mean([np.mean(band.upper - band.lower) for band in named.values()])) / 2.0
    if apart <= APART * half:
        return said
    share = 100.0 * apart / half
    return (
        *said,
        f"the models disagree: their medians are apart by {share:.0f} % of half the width of "
        "one model's band (root mean square), and tests do not yet tell which one is right here",
    )


def _given(parts: Sequence[Conditioned]) -> Conditioned | None:
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
        min(part.accepted for part in parts),
    )
