"""What a run's manifest must say, and that files are in its folder and are those of its hashes."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from mfd_bayes.campaign.schema import LawName, check_id
from mfd_bayes.errors import StoreError
from mfd_bayes.runs.folder import MANIFEST
from mfd_bayes.store.files import read_json
from mfd_bayes.store.schema import Figure, Index, Part, Positive, check

Id = Annotated[str, AfterValidator(check_id)]
_Three = Annotated[list[Figure], Field(min_length=3, max_length=3)]

_RESULTS = {"law_scores", "free_exponents", "dependence_scores", "crossvalidation", "comparison"}
"""Keys whose figures may be null, which are read as NaN."""

FORMAT = 1
"""Of a run folder. It grows when what older versions of this program wrote is read otherwise; of
the first, without a number, the manifest has no hashes."""


class _Entry(Part):
    role: Literal["calibrate", "validate"]
    status: str
    error: str = ""
    unit: str = "in"
    rate: Positive | None = None
    record_rate: Positive | None = None
    seconds: Figure = 0.0


class _Given(Part):
    session: str = ""


class _Settings(Part):
    model: str
    noise: str
    priors: str
    actuation_unit: Literal["ksi", "kip"]
    laws: dict[str, LawName]
    dependence: dict[str, list[str]] | None = None
    area: Annotated[float, Field(gt=0, le=1e10)] | None = None
    tests: dict[Id, _Given]


class _Effort(Part):
    name: str
    r_hat: float
    ess: float
    limit: int
    length: float
    ensembles: int


class _Truth(Part):
    population: dict[str, float | None]
    tests: dict[Id, dict[str, float | None]]


class _LawScore(Part):
    quantity: str
    law: LawName
    elpd: Figure
    se: Figure
    weight: Figure
    levels: Annotated[list[Figure], Field(min_length=2)]


class _DependenceScore(Part):
    quantity: str
    covariate: str
    elpd: Figure
    difference: Figure
    se: Figure


class _Score(Part):
    coverage: _Three
    width: Figure
    interval_score: Figure
    crps: Figure
    rrse: Figure


class _Prediction(Part):
    part: str
    test: Id
    score: _Score
    fitted: _Score


class _Predictions(Part):
    """What is stored of a part that was left out."""

    key: dict[str, Any]
    predictions: Annotated[list[_Prediction], Field(min_length=1)]


class _Crossvalidation(Part):
    by: Literal["test", "level", "session"]
    predictions: Annotated[list[_Prediction], Field(min_length=1)]


class _ComparisonRow(Part):
    subject: str
    model: str
    cycles: Index
    elpd: Figure
    elpd_se: Figure
    p_loo: Figure
    worst_k: Figure
    bad: Figure
    unsettled: Figure
    difference: Figure
    difference_se: Figure
    rrse: Figure


class _Comparison(Part):
    rows: list[_ComparisonRow]
    sentence: str


class _Manifest(Part):
    """Everything that is read of a manifest; whatever else it holds is only kept."""

    format: Index = 0
    title: str
    command: str
    started: str
    seed: Index
    platform: str
    effort: _Effort
    settings: _Settings
    inputs: dict[str, str]
    versions: dict[str, str]
    tests: Annotated[dict[Id, _Entry], Field(min_length=1)]
    seconds: Figure = 0.0
    files: dict[str, str] | None = None
    verdicts: dict[str, str] = Field(default_factory=dict)
    truth: _Truth | None = None
    law_scores: list[_LawScore] = Field(default_factory=list)
    free_exponents: dict[str, _Three] = Field(default_factory=dict)
    dependence_scores: list[_DependenceScore] = Field(default_factory=list)
    crossvalidation: _Crossvalidation | None = None
    comparison: _Comparison | None = None

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        unknown = set(self.tests) - set(self.settings.tests)
        if unknown:
            raise ValueError(f"its settings say nothing of test {min(unknown)!r}")
        for name in self.truth.tests if self.truth else ():
            entry = self.tests.get(name)
            if entry is None or entry.rate is None or entry.record_rate is None:
                raise ValueError(f"truth of test {name!r}, of which no rates are known")
        levels = {(score.quantity, len(score.levels)) for score in self.law_scores}
        if len(levels) > len({quantity for quantity, _ in levels}):
            raise ValueError("law_scores of one quantity must be of the same levels")
        return self


class _Finished(_Manifest):
    finished: str


def read_manifest(folder: Path) -> dict[str, Any]:
    """Manifest of a finished run, checked.

    Raises
    ------
    StoreError
        When there is none, the run is not finished, or a key is missing or of the wrong kind.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise StoreError(f"{folder} is not a run folder: it has no {MANIFEST}")
    manifest = read_json(path)
    if manifest.get("status") != "finished":
        raise StoreError(
            f"the run in {folder} is not finished; finish it with: "
            f"mfd-bayes calibrate CAMPAIGN.toml -o {folder} --resume"
        )
    return _checked(path, manifest, _Finished)


def read_begun(folder: Path) -> dict[str, Any]:
    """Manifest of a run that is to be gone on with, finished or not, checked.

    Raises
    ------
    StoreError
        When there is none, or a key is missing or of the wrong kind.
    """
    path = folder / MANIFEST
    return _checked(path, read_json(path), _Manifest)


def _checked(path: Path, manifest: dict[str, Any], kind: type[_Manifest]) -> dict[str, Any]:
    _check_version(path, manifest)
    content = check(kind, manifest, path)
    return manifest | content.model_dump(include=_RESULTS & set(manifest))


def _check_version(path: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse a run folder that a later version wrote, in which things may mean something else."""
    number = manifest.get("format", 0)
    if not isinstance(number, int) or number <= FORMAT:
        return
    versions = manifest.get("versions")
    writer = versions.get("mfd_bayes") if isinstance(versions, Mapping) else None
    later = f"mfd_bayes {writer[:20]}" if isinstance(writer, str) else "a later mfd_bayes"
    raise StoreError(
        f"{path} is of format {reprlib.repr(number)}, and mfd_bayes {version('mfd_bayes')} reads "
        f"formats up to {FORMAT}: open it with {later}"
    )


def read_predictions_of(path: Path, tests: Iterable[str]) -> list[dict[str, Any]]:
    """Predictions of the tests of a part that was left out: part, test, score and fitted of each.

    Raises
    ------
    StoreError
        When the file is missing, or does not hold these tests' predictions.
    """
    content = check(_Predictions, read_json(path), path)
    found = [prediction.test for prediction in content.predictions]
    if found != list(tests):
        raise StoreError(f"{path} holds predictions of {', '.join(found)[:200]}, not of its part")
    return [prediction.model_dump() for prediction in content.predictions]
