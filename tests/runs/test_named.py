"""What a run has by name."""

import copy
import pickle

import pytest

from mfd_bayes.errors import MfdError, NotThereError
from mfd_bayes.runs.named import Named

ITEMS = Named("calibrated test", {"a": 1, "b": 2})


@pytest.mark.parametrize("name", ["zz", None, 5, ["a"]])
def test_a_name_that_is_not_there_is_told_all_names(name):
    with pytest.raises(NotThereError, match=r"the run has no calibrated test .*: there are a, b$"):
        ITEMS[name]


def test_it_is_a_mapping_as_any_other():
    assert dict(ITEMS) == {"a": 1, "b": 2} == ITEMS
    assert ITEMS.get("zz") is None
    assert "zz" not in ITEMS
    assert [*ITEMS.values()] == [1, 2]
    assert pickle.loads(pickle.dumps(ITEMS)) == ITEMS == copy.deepcopy(ITEMS)
    with pytest.raises(KeyError):  # as with a dict
        ITEMS["zz"]
    with pytest.raises(MfdError):
        ITEMS["zz"]


def test_it_cannot_be_changed():
    given = {"a": 1}
    items = Named("test", given)
    given["b"] = 2
    assert list(items) == ["a"]
    with pytest.raises(TypeError):
        items["b"] = 2
