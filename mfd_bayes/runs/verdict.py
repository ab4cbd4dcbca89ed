"""What a check comes to."""

from enum import StrEnum


class Verdict(StrEnum):
    """Verdict of a check, a test or a run, as its files hold it, with what it means."""

    message: str

    PASS = "pass", "The value is within its limit."
    NOTE = "note", "The reader must know of it, but it is no fault of the run."
    FAIL = "fail", "The value is beyond its limit, and figures that rest on it must not be used."

    def __new__(cls, value: str, message: str) -> "Verdict":
        """Member whose value is a text, with a message."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.message = message
        return member

    @classmethod
    def of(cls, good: bool) -> "Verdict":
        """PASS or FAIL."""
        return cls.PASS if good else cls.FAIL

    @classmethod
    def noted(cls, good: bool) -> "Verdict":
        """PASS or NOTE, of a check that cannot fail."""
        return cls.PASS if good else cls.NOTE
