"""One sentence for a command that was typed wrongly, instead of a box of usage."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import Any

from typer import BadParameter
from typer.core import TyperCommand, TyperGroup

from mfd_bayes.cli.console import say

_VALUE = re.compile(r"Invalid value for '?(.+?)'?: (.*)", re.DOTALL)
"""How typer names an option or argument, and says what is wrong with it."""


class NothingEmpty(TyperCommand):
    """A command that refuses an empty text, as of a variable that is not set, for an option."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command, when no option was given an empty text."""
        for param in self.params:
            value = ctx.params.get(param.name or "")
            source = ctx.get_parameter_source(param.name or "")
            typed = source is not None and source.name == "COMMANDLINE"
            if typed and isinstance(value, str) and not value.strip():
                name = next(reversed(param.opts), param.name)
                raise BadParameter(f"{name}: got an empty text: give a value, or leave it out")
        return super().invoke(ctx)


class OneSentence(TyperGroup):
    """Commands whose wrong options end in one sentence and exit code 2."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command; where it stands alone, exit as it asks for."""
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        try:
            code = super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        except Exception as error:
            if not hasattr(error, "format_message"):
                raise
            if error.format_message():  # else the help was shown
                first = next(iter(sys.argv[1:] if args is None else args), "")
                command = f" {first}" if first in self.commands else ""
                say(f"mfd-bayes: {sentence_of(error)}; see mfd-bayes{command} -h", err=True)
            sys.exit(2)
        sys.exit(code if isinstance(code, int) else 0)


def sentence_of(error: Any) -> str:
    """What is wrong with the words that were typed."""
    said = " ".join(str(error.format_message()).split()).rstrip(".")
    found = _VALUE.fullmatch(said)
    if found is not None:
        name, said = found[1], found[2].removeprefix("Value error, ")
        if said.startswith("Input should be "):
            said = f"{name} must be {said.removeprefix('Input should be ')}"
        else:
            said = f"{name}: {said}"
    return said
