"""A page of a response has something to show."""

import pytest

from mfd_bayes.errors import BuildingError
from mfd_bayes.reporting.response_page import ResponseView
from mfd_bayes.response.result import Row

ROW = Row("drift", "quake.csv", "storey 1", "in", 1.0, 1.0, ((0.9, 1.1),) * 3, 2.0, 1.5)


def view(rows=(), sweep=""):
    grounds = "quake.csv", "other.csv"
    return ResponseView("", "", "fail", (), (), rows, (), {}, sweep, grounds, 1, True, {})


def test_a_page_without_a_draw_that_stayed_and_without_a_sweep_is_refused():
    with pytest.raises(BuildingError, match=r"every draw diverged under quake\.csv, other\.csv: "):
        view()
    assert view((ROW,)).rows == (ROW,)  # one of the ground motions is enough
    assert view(sweep="The mean of the largest drift is smallest at 3 MPa.").rows == ()
