"""The words of the project with their meanings, for the report and for the documentation."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files

from markupsafe import Markup


@dataclass(frozen=True)
class Term:
    """A word and its meaning, as HTML."""

    name: str
    text: Markup


@dataclass(frozen=True)
class Group:
    """The words of one subject."""

    title: str
    terms: tuple[Term, ...]


def read_glossary() -> tuple[Group, ...]:
    """Every word, by subject, in the order of reading."""
    text = files("mfd_bayes.reporting").joinpath("glossary.toml").read_text(encoding="utf-8")
    return tuple(
        Group(group["title"], tuple(Term(t["name"], Markup(t["text"])) for t in group["term"]))
        for group in tomllib.loads(text)["group"]
    )
