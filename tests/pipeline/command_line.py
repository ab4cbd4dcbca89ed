"""What a command says, for tests of whole commands."""

from typer.testing import CliRunner

from mfd_bayes.cli.commands import app


def said(*words, code=0):
    """Words that a command prints, with one space between them; it must end with `code`."""
    outcome = CliRunner().invoke(app, [str(word) for word in words])
    assert outcome.exit_code == code, outcome.output
    return " ".join(outcome.output.split())
