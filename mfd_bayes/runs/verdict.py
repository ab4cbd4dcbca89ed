"""What a check, a test or a whole run comes to."""

from enum import StrEnum


class Verdict(StrEnum):
    """Verdict of a check, as its files hold it, with what it means."""

    message: str

    PASS = "pass", "The value is within its limit."
    NOTE = "note", "The reader must know of it, but it is no fault of the run."
    WARNING = (
        "warning",
        "The model misses this by more than its tolerance; use what depends on it with care.",
    )
    FAIL = "fail", "The value is beyond its limit; do not use figures that depend on it."

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


class Use(StrEnum):
    """What a test or a run may be used for, in the words of its verdict; the best first."""

    USABLE = "usable"
    WITH_CARE = "usable with care"
    NOT_USABLE = "not usable"

    @property
    def mark(self) -> Verdict:
        """The verdict of a check that looks like it."""
        marks = {self.USABLE: Verdict.PASS, self.WITH_CARE: Verdict.WARNING}
        return marks.get(self, Verdict.FAIL)
