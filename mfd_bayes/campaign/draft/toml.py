"""Texts from files as TOML takes them: strings that stay strings, comments that stay comments."""

from __future__ import annotations

import json


def quoted(text: str) -> str:
    """TOML basic string of any text that UTF-8 can hold."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def commented(text: str) -> str:
    """Text of a comment: on one line, without control characters or what UTF-8 cannot hold."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return f"# {shown}"


def column(name: str, unit: str | None) -> str:
    """Inline table of a column."""
    stated = "" if unit is None else f", unit = {quoted(unit)}"
    return f"{{ name = {quoted(name)}{stated} }}"
