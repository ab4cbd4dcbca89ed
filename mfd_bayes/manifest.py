"""What a finished run's manifest must say, and that files are those whose hashes it holds."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from mfd_bayes.campaign import check_id
from mfd_bayes.errors import StoreError
from mfd_bayes.records.record import hash_file
from mfd_bayes.store import MANIFEST, read_json

Id = Annotated[str, AfterValidator(check_id)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


class _Entry(_Part):
    role: Literal["calibrate", "validate"]
    status: str
    error: str = ""
    unit: str = "in"
    rate: float | None = None
    record_rate: float | None = None


class _Given(_Part):
    session: str = ""


class _Settings(_Part):
    model: str
    noise: str
    priors: str
    actuation_unit: Literal["ksi", "kip"]
    laws: dict[str, str]
    dependence: dict[str, list[str]] | None = None
    area: Annotated[float, Field(gt=0)] | None = None
    tests: dict[Id, _Given]


class _Effort(_Part):
    name: str
    r_hat: float
    ess: float


class _Manifest(_Part):
    """What is read of a manifest; whatever else it holds is only kept."""

    title: str
    command: str
    started: str
    finished: str
    seed: int
    platform: str
    effort: _Effort
    settings: _Settings
    inputs: dict[str, str]
    versions: dict[str, str]
    tests: Annotated[dict[Id, _Entry], Field(min_length=1)]
    files: dict[str, str] | None = None
    verdicts: dict[str, str] = {}
    law_scores: list[dict[str, Any]] = []
    free_exponents: dict[str, Annotated[list[float], Field(min_length=3, max_length=3)]] = {}
    dependence_scores: list[dict[str, Any]] = []


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
    try:
        content = _Manifest.model_validate(manifest)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        where = ".".join(str(part)[:60] for part in fault["loc"])
        raise StoreError(
            f"{path} is damaged or of another version of this program: {where}: {fault['msg']}, "
            f"got {reprlib.repr(fault['input'])}"
        ) from None
    unknown = set(content.tests) - set(content.settings.tests)
    if unknown:
        raise StoreError(f"settings in {path} say nothing of test {min(unknown)!r}")
    return manifest


def check_stored(out: Path, name: str, digests: Mapping[str, Any]) -> Path:
    """Path of a stored file that is in its run folder and, where its hash is known, unchanged.

    Parameters
    ----------
    out : Path
        Run folder.
    name : str
        Path of the file in it, with slashes.
    digests : mapping of str to str
        SHA-256 of files by such names.

    Raises
    ------
    StoreError
        When the file lies elsewhere, is missing, or is another than was written.
    """
    path = out / name
    try:
        if not path.resolve().is_relative_to(out.resolve()):
            raise StoreError(f"{path} is a link to outside of the run folder")
        if name in digests and hash_file(path) != digests[name]:
            raise StoreError(
                f"{path} is not what this run wrote: its SHA-256 is not that in {MANIFEST}"
            )
    except (OSError, RuntimeError) as error:
        raise StoreError(f"cannot read {path}: {error}") from error
    return path


def hash_stored(out: Path, names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of those files of a run folder that there are."""
    return {name: hash_file(out / name) for name in names if (out / name).is_file()}
