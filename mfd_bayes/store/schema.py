"""What JSON of a run folder must say: kinds are strict, the first fault is told in a sentence."""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
)

from mfd_bayes.errors import StoreError

LARGEST = 1e100
"""Largest size of a figure: its square is a number still."""


class Part(BaseModel):
    """An object of JSON; what it holds besides its fields is not read."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


Kind = TypeVar("Kind", bound=Part)


def _bounded(value: float) -> float:
    if abs(value) > LARGEST:  # NaN is not
        raise ValueError(f"must not be beyond {LARGEST:g}")
    return value


Figure = Annotated[
    float,
    Field(allow_inf_nan=True),
    BeforeValidator(lambda value: math.nan if value is None else value),
    AfterValidator(_bounded),
]
"""A computed number, NaN where it was not finite: JSON has null for that."""

Positive = Annotated[float, Field(gt=0.0, le=LARGEST)]
Index = Annotated[int, Field(ge=0)]


def check(kind: type[Kind], content: Any, where: object) -> Kind:
    """Content of a JSON text as a `Part`.

    Parameters
    ----------
    kind : type of Part
    content : dict
        As JSON gives it.
    where : Path or str
        The file, which is named in what is said.

    Raises
    ------
    StoreError
        When a key is missing or of the wrong kind.
    """
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        key = ".".join(str(part)[:60] for part in fault["loc"])
        raise StoreError(
            f"{where} is damaged or of another version of this program: "
            f"{f'{key}: ' if key else ''}{fault['msg'].removeprefix('Value error, ')}, "
            f"got {reprlib.repr(fault['input'])}"
        ) from None
