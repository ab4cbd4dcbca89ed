"""The command line in this process, where warnings are errors, and the records it reads."""

import numpy as np
from typer.testing import CliRunner

from mfd_bayes.cli.commands import app

NAMES = ("time_s", "displacement_in", "force_kip")


def here(*words):
    """Outcome of a command."""
    return CliRunner().invoke(app, [str(word) for word in words])


def said(*words, code=0):
    """Words that a command prints, with one space between them; it must end with `code`."""
    outcome = here(*words)
    assert outcome.exit_code == code, (outcome.output, outcome.exception)
    return " ".join(outcome.output.split())


def refusal(*words):
    """The one sentence with which a command is refused."""
    outcome = here(*words)
    assert outcome.exit_code == 2, (outcome.output, outcome.exception)
    (sentence,) = outcome.stderr.splitlines()
    assert sentence.startswith("mfd-bayes: ")
    return sentence


def contents(folder):
    """Every file below a folder with its content, and every other thing with its kind."""
    return {
        str(path): path.read_bytes() if path.is_file() else path.lstat().st_mode
        for path in folder.rglob("*")
    }


def write_csv(path, *columns, names=NAMES):
    """A record of some columns: time in s, displacement in in, force in kip."""
    head = ",".join(names[: len(columns)])
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=head, comments="")
    return path
