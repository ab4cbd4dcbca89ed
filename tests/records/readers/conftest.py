"""What the tests of readers share."""

import pytest

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import read_table


@pytest.fixture
def refused():
    """Sentence with which columns of a file are refused."""

    def sentence(path, names=("a",)):
        with pytest.raises(RecordError) as caught:
            read_table(path).columns(names)
        message = str(caught.value)
        assert str(path) in message
        assert "\n" not in message
        return message

    return sentence
