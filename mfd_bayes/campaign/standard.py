"""A standard for damping devices: its requirements, as a TOML file has them.

Those of the package lie in `applications/properties/standards`; a user's own has the same form.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from mfd_bayes.campaign.schema import Limit, QuantityName, Text, TomlTable
from mfd_bayes.errors import CampaignError, file_inside
from mfd_bayes.records.cycles import quantities
from mfd_bayes.store.files import TomlError, faults_text, read_toml

_FREQUENCY = re.compile(r"(\d+(?:\.\d+)?)/(?:T1|\((\d+(?:\.\d+)?) ?T1\))")


def _of_period(text: str) -> str:
    """A frequency as a multiple of 1/T1, unchanged."""
    if _FREQUENCY.fullmatch(text) is None:
        raise ValueError('a frequency reads "1/T1", "2.5/T1" or "1/(1.5 T1)"')
    return text


Statistic = Literal[
    "cycle over mean",
    "cycle over third",
    "mean over target",
    "supply",
    "change with rate",
    "change with temperature",
    "change with age",
    "sequence",
    "devices",
    "production",
]
"""What a requirement is about: see `properties.conformity`."""


class ProtocolStep(TomlTable):
    """A test that a standard asks for."""

    amplitude: Annotated[float, Field(gt=0, le=2)]
    """as a share of the largest displacement, `mce` in `[design]`"""
    cycles: Annotated[int, Field(ge=1, le=10000)]
    frequency: Annotated[str, AfterValidator(_of_period)] = ""
    """`"1/(1.5 T1)"`; any, where it is left out"""

    def hertz(self, period: float | None) -> float | None:
        """Frequency, Hz, of a building of that period, s; None for any."""
        read = _FREQUENCY.fullmatch(self.frequency)
        return float(read[1]) / (float(read[2] or 1.0) * period) if read and period else None


class Requirement(TomlTable):
    """One requirement."""

    clause: Text
    requirement: Text
    statistic: Statistic
    limits: dict[QuantityName, Limit] = Field(default_factory=dict)
    """largest deviation of each quantity, as a share"""
    steps: Annotated[tuple[ProtocolStep, ...], Field(max_length=100)] = ()
    rate_limit: Limit | None = None
    """a sequence is asked for only where `rate_quantities` change with the rate by more"""
    rate_quantities: tuple[QuantityName, ...] = ()
    devices: Annotated[int, Field(ge=0)] = 0
    share: Annotated[float, Field(ge=0, le=1)] = 0.0
    """of the devices of a supply that must be tested"""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        needs = {"sequence": "steps", "devices": "devices", "production": "share"}
        needed = needs.get(self.statistic, "limits")
        if self.statistic != "change with age" and not getattr(self, needed):
            raise ValueError(f"a requirement of statistic {self.statistic!r} needs {needed}")
        return self


class FactorRule(TomlTable):
    """How λ of tests, of ageing and of the specification are composed (ASCE/SEI 7, 18.2.4.5).

    λ_max = [1 + s (λ_ae,max − 1)] λ_test,max λ_spec,max, at least `max_at_least`, and
    λ_min = [1 − s (1 − λ_ae,min)] λ_test,min λ_spec,min, at most `min_at_most`.
    """

    clause: Text
    ageing_share: Annotated[float, Field(ge=0, le=1)]
    max_at_least: Annotated[float, Field(ge=1)]
    min_at_most: Annotated[float, Field(gt=0, le=1)]
    note: Text = ""


class Standard(TomlTable):
    """A standard: its requirements, and what it calls the quantities."""

    title: Text
    read: Annotated[str, Field(max_length=1000)]
    """where its figures were read"""
    symbols: dict[QuantityName, Text] = Field(default_factory=dict)
    factors: FactorRule | None = None
    requirement: Annotated[tuple[Requirement, ...], Field(min_length=1, max_length=100)]


_TABLES: Mapping[str, type[TomlTable]] = MappingProxyType(
    {"": Standard, "requirement": Requirement, "factors": FactorRule, "steps": ProtocolStep}
)


def _folder() -> Path:
    return Path(str(files("mfd_bayes") / "applications" / "properties" / "standards"))


def standard_names() -> tuple[str, ...]:
    """Names of the standards of the package."""
    return tuple(sorted(path.stem for path in _folder().glob("*.toml")))


def read_standard(name: str, folder: Path, of: str) -> Standard:
    """A standard by its name, or by the path of a TOML file inside a folder.

    `of` says in a message where the name stands. Raises CampaignError where there is none, or
    where the file is not of this form.
    """
    path = _folder() / f"{name}.toml"
    if name not in standard_names():
        if not name.endswith(".toml"):
            raise CampaignError(
                f"{of}: there is no standard {name!r}; expected {', '.join(standard_names())}, or "
                "a file of your own that ends in .toml"
            )
        inside = file_inside(folder, name)
        if inside is None or not inside.is_file():
            raise CampaignError(f"{of}: there is no file {name!r} in the folder of the campaign")
        path = inside
    try:
        content = read_toml(path)
    except TomlError as error:
        raise CampaignError(f"{path} {error}") from error
    try:
        return Standard.model_validate(content)
    except ValidationError as error:
        raise CampaignError(faults_text(path, content, error, _keys)) from None


def _keys(tables: list[str]) -> Collection[str]:
    """Keys that a table of a standard may have."""
    table = tables[-1] if tables else ""
    return _TABLES[table].model_fields if table in _TABLES else quantities()
