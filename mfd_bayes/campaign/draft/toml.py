"""Texts from files, such as names of columns, written as TOML strings and comments.

`tomlkit` would not make this shorter: control characters in its comments must be escaped as here,
and it writes a table value by value.
"""

from __future__ import annotations

import json


def quoted(text: str) -> str:
    """TOML basic string of a text."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def commented(text: str) -> str:
    """TOML comment of a text: on one line, with escapes for all that cannot be printed."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return f"# {shown}"


def column(
    name: str, unit: str | None, number: int | None = None, sign: int = 1, rate: str = ""
) -> str:
    """TOML inline table of a column, given by its number where it has one, or of a rate."""
    if rate:
        return f"{{ rate = {quoted(rate)} }}"
    stated = "" if unit is None else f", unit = {quoted(unit)}"
    turned = "" if sign == 1 else f", sign = {sign}"
    given = f"name = {quoted(name)}" if number is None else f"column = {number}"
    return f"{{ {given}{stated}{turned} }}"
