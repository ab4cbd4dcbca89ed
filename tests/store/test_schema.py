"""Strict types, numbers that may be null, and one short sentence for the first fault."""

import math

import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.store.schema import Figure, Index, Part, Positive, check


class Sample(Part):
    name: str
    figure: Figure = 0.0
    size: Positive = 1.0
    count: Index = 0


def test_what_fits_is_read_and_null_is_a_figure_that_was_not_finite():
    sample = check(Sample, {"name": "a", "figure": 3, "more": 1}, "manifest.json")
    assert (sample.name, sample.figure) == ("a", 3.0)
    assert math.isnan(check(Sample, {"name": "a", "figure": None}, "manifest.json").figure)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("name", ["x" * 10_000] * 100), ("figure", "1"), ("figure", True)),
        *(("figure", 10**400), ("size", 0.0), ("size", math.nan), ("count", 1.0)),
    ],
)
def test_what_does_not_fit_is_named_with_its_file_and_key(key, value):
    with pytest.raises(StoreError, match=rf"manifest\.json .*: {key}: .*, got ") as caught:
        check(Sample, {"name": "a"} | {key: value}, "manifest.json")
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("content", [[], {}])
def test_something_else_than_the_object_is_refused(content):
    with pytest.raises(StoreError, match=r"manifest\.json"):
        check(Sample, content, "manifest.json")
