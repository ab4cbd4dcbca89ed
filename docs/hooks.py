"""What the site's pages take from the project when they are built, so that it cannot go stale.

A line of a page that reads

    {{ commands }}                                      is replaced by every command's --help,
    {{ glossary }}                                      by every word of the glossary,
    {{ keys of goal }}                                  by the keys of a table of a campaign file,
    {{ lines of benchmarks/sbc/sbc.txt with uniform }}  by the lines of a file that match a pattern,
    {{ file priors/mfd.toml }}                          by a whole file.

Links to files of the project (`../../tests/test_units.py`) become links to copies of them in the
site, and formulas become MathML, which browsers show without any script.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html import unescape
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
LINKED = ("tests/**/*.py", "benchmarks/*/*.txt")
SHOWN = ("reports/report.html", "reports/figures/overview.png")

_DIRECTIVE = re.compile(r"^\{\{ (.+) \}\}$", re.MULTILINE)
_LINK = re.compile(r"\]\(\.\./\.\./([\w./-]+)\)")
_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: Any) -> Files:
    """Add the project's files that pages link to: sources as plain text, which browsers show."""
    for pattern in (*LINKED, *SHOWN):
        for path in sorted(ROOT.glob(pattern)):
            name = _site_name(path.relative_to(ROOT).as_posix())
            files.append(File.generated(config, name, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in what a page asks for, and point its links to the copies in the site."""
    filled = _DIRECTIVE.sub(lambda found: _fill(found[1], page.file.src_uri), markdown)
    return _LINK.sub(lambda found: f"]({_site_name(found[1])})", filled)


def on_page_content(html: str, **_: Any) -> str:
    """Turn formulas into MathML."""
    return _FORMULA.sub(_mathml, html)


def _site_name(path: str) -> str:
    """Place of a file of the project in the site."""
    shown = path.endswith((".html", ".png"))
    return f"project/{path}" if shown else f"project/{path}.txt"


def _fill(wish: str, page: str) -> str:
    if wish == "commands":
        return "\n\n".join(_help(command) for command in _commands())
    if wish == "glossary":
        return _glossary()
    if table := re.fullmatch(r"keys of (\w+)", wish):
        return _keys(table[1], page)
    if lines := re.fullmatch(r"lines of (\S+) with (.+)", wish):
        text = (ROOT / lines[1]).read_text(encoding="utf-8")
        kept = [line for line in text.splitlines() if re.search(lines[2], line)]
        if not kept:
            raise PluginError(f"{page}: no line of {lines[1]} has {lines[2]!r}")
        return _fenced("\n".join(kept), lines[1])
    if whole := re.fullmatch(r"file (\S+)", wish):
        return _fenced((ROOT / whole[1]).read_text(encoding="utf-8").rstrip(), whole[1])
    raise PluginError(f"{page}: cannot fill in {wish!r}")


def _glossary() -> str:
    """Sections with the words of the project, each with its meaning."""
    from mfd_bayes.reporting.page import read_glossary

    return "\n\n".join(
        "\n\n".join([f"## {title}", *(f"**{name}**: {text}" for name, text in terms.items())])
        for title, terms in read_glossary().items()
    )


def _keys(table: str, page: str) -> str:
    """Table of the keys of a table of a campaign file, each with its default and meaning."""
    from mfd_bayes.campaign.schema import keys_of

    try:
        keys = keys_of(table)
    except KeyError:
        raise PluginError(f"{page}: a campaign file has no table {table!r}") from None
    rows = [(f"`{name}`", default, meaning) for name, (default, meaning) in keys.items()]
    cells = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    lines = [
        "| key | default | meaning |",
        "|---|---|---|",
        *(f"| {' | '.join(c)} |" for c in cells),
    ]
    return "\n".join(lines)


def _fenced(text: str, title: str) -> str:
    kind = "toml" if title.endswith(".toml") else "text"
    return f'```{kind} title="{title}"\n{text}\n```'


def _commands() -> list[str]:
    """Names of the commands, in the program's own order."""
    from typer.main import get_command

    from mfd_bayes.cli.commands import app

    return ["", *get_command(app).commands]  # type: ignore[attr-defined]  # app is a group


def _help(command: str) -> str:
    """Section of one command with what it says of itself, or of the program for an empty name."""
    program = Path(sys.executable).with_name("mfd-bayes")
    plain = os.environ | {"COLUMNS": "80", "TERM": "dumb", "NO_COLOR": "1"}
    said = subprocess.run(
        [program, *command.split(), "--help"], capture_output=True, text=True, check=True, env=plain
    ).stdout
    text = "\n".join(line.rstrip() for line in said.strip("\n").splitlines())
    return f"## `{f'mfd-bayes {command}'.strip()}`\n\n```text\n{text}\n```"


def _mathml(found: re.Match[str]) -> str:
    display = "block" if found[1] == "div" else "inline"
    formula = convert(unescape(found[2]).strip(), display=display)
    return f'<div class="formula">{formula}</div>' if display == "block" else formula
