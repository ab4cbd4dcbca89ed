"""Sentences that keep their quantities as data; they are written in the reader's units once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from string import Formatter
from typing import Protocol

from mfd_bayes.units import in_digits


class Writer(Protocol):
    """Writes for a reader, as `runs.unit_system.UnitSystem` does."""

    def words(self, values: Sequence[float], internal: str, digits: int) -> str:
        """Values of an internal unit with a number of digits: `([0.2, 0.3], "in", 3)`."""

    def text(self, words: str) -> str:
        """Words of a sentence, in which motion and response are called as the model's are."""


@dataclass(frozen=True)
class Measure:
    """One value, or the ends of a range, in an internal unit (kip, in, s, ksi, …)."""

    values: tuple[float, ...]
    unit: str
    digits: int = 3

    def __post_init__(self) -> None:
        if not (self.values and 0 < self.digits <= 17):
            raise ValueError(f"{self} has no values, or digits that are not 1 to 17")

    @classmethod
    def of(cls, *values: float, unit: str, digits: int = 3) -> Measure:
        """Quantity of one value or of the ends of a range."""
        return cls(tuple(float(value) for value in values), unit, digits)


@dataclass(frozen=True)
class Message:
    """A sentence with named quantities: `Message("the force jumps by {jump}", {"jump": …})`.

    Attributes
    ----------
    template : str
        As `str.format` takes it; braces that are meant are doubled.
    values : mapping
        By name: a `Measure`, which is written in the reader's units, or text, which stays.
    """

    template: str
    values: Mapping[str, Measure | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for _, name, form, conversion in Formatter().parse(self.template):
            if form or conversion or not (name is None or name in self.values):
                raise ValueError(f"{self.template!r} has a place without a value")

    def to_text(self, writer: Writer) -> str:
        """The sentence with its quantities as `writer` writes them."""
        texts = {
            name: writer.words(value.values, value.unit, value.digits)
            if isinstance(value, Measure)
            else value
            for name, value in self.values.items()
        }
        return writer.text(self.template).format(**texts)

    def __str__(self) -> str:
        """The sentence in internal units."""
        return self.to_text(_Internal())


class _Internal:
    """Writes values in internal units."""

    def words(self, values: Sequence[float], internal: str, digits: int) -> str:
        texts = dict.fromkeys(in_digits(value, digits) for value in values)
        return f"{' to '.join(texts)} {internal.replace('*', '·')}"

    def text(self, words: str) -> str:
        return words


def counted(number: int, noun: str) -> str:
    """Number with its noun: "1 test", "3 tests"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def join(messages: Iterable[Message], separator: str) -> Message:
    """Several sentences as one, with a separator between them."""
    templates, values = [], {}
    for number, message in enumerate(messages):
        segments = []
        for text, name, _, _ in Formatter().parse(message.template):
            segments.append(text.replace("{", "{{").replace("}", "}}"))
            if name is not None:
                segments.append(f"{{{name}_{number}}}")
                values[f"{name}_{number}"] = message.values[name]
        templates.append("".join(segments))
    return Message(separator.join(templates), values)
