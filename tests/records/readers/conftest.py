"""What the tests of readers share."""

import pytest

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import read_columns


@pytest.fixture
def refused():
    """Sentence with which columns of a file are refused."""

    def sentence(path, names=("a",)):
        with pytest.raises(RecordError) as caught:
            read_columns(path, names)
        message = str(caught.value)
        assert str(path) in message
        assert "\n" not in message
        return message

    return sentence
