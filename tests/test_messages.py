"""Sentences that keep their quantities as data."""

from mfd_bayes.messages import Message, Quantity
from mfd_bayes.runs.unit_system import SI, US

GAP = Quantity.of(0.2, 0.3, unit="in")
MESSAGE = Message("the gap of {test} is {gap}, {{sic}}", {"test": "2 in", "gap": GAP})


def test_quantities_are_written_in_the_units_of_the_reader_and_text_stays():
    assert str(MESSAGE) == MESSAGE.to_text(US) == "the gap of 2 in is 0.2 to 0.3 in, {sic}"
    assert MESSAGE.to_text(SI) == "the gap of 2 in is 5.08 to 7.62 mm, {sic}"
