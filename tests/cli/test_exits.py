"""How a command ends on an error."""

import pytest
import typer

from mfd_bayes.cli.errors import mistakes


@pytest.mark.parametrize(
    ("error", "resume", "said"),
    [
        (MemoryError(), "", "memory is too short"),
        (MemoryError("Unable to allocate 3 GiB"), "", "short: Unable to allocate 3 GiB"),
        (MemoryError(), "a --resume", "short; what is finished is kept, go on with: a --resume"),
    ],
)
def test_short_memory_is_said_in_a_sentence(capsys, error, resume, said):
    with pytest.raises(typer.Exit) as ended, mistakes(resume):
        raise error
    assert ended.value.exit_code == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.startswith("mfd-bayes: ")
    assert sentence.endswith(said)
