"""Texts from files, such as names of columns, written as TOML strings and comments."""

from __future__ import annotations

import json


def quoted(text: str) -> str:
    """TOML basic string of a text."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def commented(text: str) -> str:
    """TOML comment of a text: on one line, with escapes for all that cannot be printed."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return f"# {shown}"
