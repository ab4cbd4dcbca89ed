"""Tables of candidates, and their rows and columns."""

import numpy as np
import pytest

from mfd_bayes.errors import NotThereError
from mfd_bayes.planning.advice import Advice, Row
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.planning.gain import Gain
from mfd_bayes.planning.goal import Goal


@pytest.fixture
def advice():
    gain = Gain(reduction=0.2, error=0.01, information=0.3, information_error=0.02)
    rows = tuple(Row(Candidate(1.0, 0.5, 1.0, price=p), gain, False) for p in (2.0, 0.0))
    return Advice(Goal(), "kip", 1.0, rows, (), (), (), 200)


@pytest.mark.parametrize("key", [99, -3, None, 1.5, [0], "zz"])
def test_a_row_or_column_that_is_not_there_is_named(advice, key):
    with pytest.raises(NotThereError, match=r"no (row|column) .*reduction"):
        advice[key]


def test_rows_and_columns_are_found(advice):
    assert advice[0] is advice.rows[0]
    assert advice[np.int64(-1)] is advice.rows[1]
    assert advice[:1] == advice.rows[:1]
    assert advice["cost"] == [2.0, 0.0]
    assert list(advice) == list(advice.rows)
    assert advice.index(advice.rows[1]) in (0, 1)


def test_a_test_that_costs_nothing_reduces_without_end(advice):
    assert [row.per_hour for row in advice] == [0.1, np.inf]
