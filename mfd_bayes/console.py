"""What is printed: sentences and tables, in which nothing is markup."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import Console


_ESCAPES = re.compile(
    r"""(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]              # colours, movements of the cursor
      | (?:\x1b[]PX^_]|[\x90\x98\x9d-\x9f])[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)?  # titles, links
      | \x1b[ -/]*[0-~]?""",
    re.VERBOSE,
)


def clean(text: object) -> str:
    """Text as a terminal may show it: one line, without escape sequences and control characters."""
    return "".join(c if c.isprintable() else " " for c in _ESCAPES.sub("", str(text)))


def say(sentence: object, *, err: bool = False) -> None:
    """Print a line."""
    typer.echo(clean(sentence), err=err)


def warn(remarks: Iterable[str]) -> None:
    """Print remarks as warnings, each once."""
    for remark in dict.fromkeys(remarks):
        say(f"warning: {remark}", err=True)


def open_console() -> Console:
    """Console that prints every text as it is, 110 columns wide where it is no terminal."""
    from rich.console import Console

    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console.width = 110
    return console


def print_rows(
    title: str,
    heads: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    folded: int = 1,
    caption: str = "",
    last: Sequence[object] = (),
) -> None:
    """Print a table: its first columns fold long texts, the others keep them on one line.

    `last` is a row below a line.
    """
    from rich.table import Table

    table = Table(title=clean(title), caption=clean(caption) or None)
    for k, head in enumerate(heads):
        if k < folded:
            table.add_column(head, overflow="fold", min_width=min(len(head), 8))
        else:
            table.add_column(head, no_wrap=True)
    for cells in rows:
        table.add_row(*map(clean, cells))
    if last:
        table.add_section()
        table.add_row(*map(clean, last))
    open_console().print(table)


def figures(values: Iterable[float], digits: int = 4) -> list[str]:
    """Numbers as a table has them, a dash for NaN."""
    return ["–" if math.isnan(value) else f"{value:.{digits}g}" for value in values]
