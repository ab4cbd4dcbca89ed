"""Sentences that keep their quantities as data."""

import json

import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.messages import Message, Quantity
from mfd_bayes.runs.unit_system import SI, US

GAP = Quantity.of(0.2, 0.3, unit="in")
MESSAGE = Message("the gap of {test} is {gap}, {{sic}}", {"test": "2 in", "gap": GAP})


def test_quantities_are_written_in_the_units_of_the_reader_and_text_stays():
    assert str(MESSAGE) == MESSAGE.to_text(US.words) == "the gap of 2 in is 0.2 to 0.3 in, {sic}"
    assert MESSAGE.to_text(SI.words) == "the gap of 2 in is 5.08 to 7.62 mm, {sic}"


def test_a_message_is_the_same_once_it_is_stored():
    content = json.loads(json.dumps(MESSAGE.to_json()))
    quantity = {"values": [0.2, 0.3], "unit": "in", "digits": 3}
    assert content["values"] == {"test": "2 in", "gap": quantity}
    assert Message.from_json(content) == MESSAGE


@pytest.mark.parametrize(
    "content",
    [
        None,
        "the gap",
        {"template": "x"},
        {"template": "{y}", "values": {}},
        {"template": "{0}", "values": {}},
        {"template": "{x", "values": {}},
        {"template": "{x}", "values": {"x": 3}},
        {"template": "{x}", "values": {"x": {"values": ["wide"], "unit": "in", "digits": 3}}},
        {"template": "{x.unit}", "values": {"x": "text"}},
    ],
)
def test_what_is_no_message_is_refused(content):
    with pytest.raises(StoreError, match="is no message"):
        Message.from_json(content)
