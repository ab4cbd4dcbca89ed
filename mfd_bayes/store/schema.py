"""Checks of the JSON in a run folder: types are strict, the message names the first fault."""

from __future__ import annotations

import json
import math
import reprlib
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from mfd_bayes.errors import StoreError

LARGEST = 1e100  # largest size of a figure: its square does not overflow


class Part(BaseModel):
    """An object of JSON; keys other than its fields are ignored."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


Kind = TypeVar("Kind", bound=Part)


def _bounded(value: float) -> float:
    if abs(value) > LARGEST:  # false for NaN
        raise ValueError(f"must not be larger than {LARGEST:g} in size")
    return value


Figure = Annotated[
    float,
    Field(allow_inf_nan=True),
    BeforeValidator(lambda value: math.nan if value is None else value),
    AfterValidator(_bounded),
]
"""A computed number; null in JSON is NaN."""

Positive = Annotated[float, Field(gt=0.0, le=LARGEST)]
Index = Annotated[int, Field(ge=0)]

Item = TypeVar("Item")
AtLeastOne = Annotated[tuple[Item, ...], Field(min_length=1)]
Three = Annotated[tuple[Figure, ...], Field(min_length=3, max_length=3)]


def check(kind: type[Kind], content: Any, where: object) -> Kind:
    """Content of a JSON file as a `Part`.

    `where` is the file, for the message.
    """
    try:
        return kind.model_validate_json(json.dumps(content))  # strict, but lists become tuples
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        key = ".".join(str(part)[:60] for part in fault["loc"])
        raise StoreError(
            f"{where} is damaged or of another version of this program: "
            f"{f'{key}: ' if key else ''}{fault['msg'].removeprefix('Value error, ')}, "
            f"got {reprlib.repr(fault['input'])}"
        ) from None
