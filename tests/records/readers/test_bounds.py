"""Bounds on text and JSON files, from just below to just above."""

import json

import pytest

from mfd_bayes.campaign.draft.columns import guess_columns, numbers_of
from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.readers.table import COLUMNS
from mfd_bayes.records.readers.text import LINE


def test_a_line_may_be_long_but_not_longer(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("a,b\n1,2\n#" + "x" * (LINE - 2) + "\n")
    assert read_table(path).names == ("a", "b")
    path.write_text("a,b\n1,2\n#" + "x" * LINE + "\n")
    with pytest.raises(RecordError, match=r"line 3 of .*a\.csv is longer"):
        read_table(path)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_every_end_of_a_line_ends_it(tmp_path, end):
    path = tmp_path / "a.csv"
    lines = ["a,b", *["1,2"] * (LINE // 3)]
    path.write_bytes(end.join(lines).encode())
    assert read_table(path).columns(["b"])["b"].size == len(lines) - 1


@pytest.mark.parametrize("kind", ["csv", "json"])
def test_a_thousand_columns_and_no_more(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    for count in (COLUMNS, COLUMNS + 1):
        names = [f"c{i}" for i in range(count)]
        table = {"csv": ",".join(names) + "\n" + ",".join("1" * count) + "\n"}
        table["json"] = json.dumps({name: [1.0] for name in names})
        path.write_text(table[kind])
        if count == COLUMNS:
            assert len(read_table(path).names) == count
        else:
            with pytest.raises(RecordError, match="1,001 columns"):
                read_table(path)


@pytest.mark.parametrize("name", ["(" * 5000, "[ " * 5000, "_" * 5000, "a_per_" * 900])
def test_a_name_that_takes_patterns_long_is_refused(tmp_path, name):
    path = tmp_path / "a.csv"
    path.write_text(f"time_s,{name}\n1,2\n2,3\n")
    with pytest.raises(RecordError, match="the name of column 2"):
        read_table(path)


def test_numbers_too_large_are_no_column_that_is_guessed(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("a,b\n" + "".join(f"{i},{(-1) ** i * 1e200}\n" for i in range(50)))
    table = read_table(path)
    assert numbers_of(table, "b") is None
    assert "b" not in {guess.name for guess in guess_columns(table).values()}
