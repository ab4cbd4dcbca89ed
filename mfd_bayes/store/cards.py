"""What a notebook shows of an object: a title and a few rows, as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def card(title: str, facts: Iterable[tuple[str, str]], note: str = "") -> str:
    """HTML of a title, of facts as pairs of name and text, and of a note below."""
    rows = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(text)}</td></tr>'
        for name, text in facts
    )
    footer = f"<p>{escape(note)}</p>" if note else ""
    return f"<div><strong>{escape(title)}</strong><table>{rows}</table>{footer}</div>"


def grid(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], note: str = "") -> str:
    """HTML of a title, a table with a head, and a note below."""
    top = "".join(f'<th style="text-align:left">{escape(name)}</th>' for name in head)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    footer = f"<p>{escape(note)}</p>" if note else ""
    table = f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
    return f"<div><strong>{escape(title)}</strong>{table}{footer}</div>"
