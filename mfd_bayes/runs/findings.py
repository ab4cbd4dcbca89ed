"""Words for what is found of a run and its tests."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from mfd_bayes.messages import Message


class CheckStatus(StrEnum):
    """Verdict of a check, as its files hold it."""

    PASS = "pass"
    NOTE = "note"
    """The reader must know of it, but it is no fault of the run."""
    WARNING = "warning"
    """The model misses this by more than its tolerance."""
    FAIL = "fail"
    """The value is beyond its limit: figures that depend on it must not be used."""

    @classmethod
    def of(cls, condition: bool) -> CheckStatus:
        """PASS or FAIL."""
        return cls.PASS if condition else cls.FAIL

    @classmethod
    def pass_or_note(cls, condition: bool) -> CheckStatus:
        """PASS or NOTE, of a check that cannot fail."""
        return cls.PASS if condition else cls.NOTE


class Fitness(StrEnum):
    """What a test or a run may be used for, in the words of its verdict; the best first."""

    USABLE = "usable"
    WITH_CARE = "usable with care"
    NOT_USABLE = "not usable"

    @property
    def mark(self) -> CheckStatus:
        """The verdict of a check that looks like it."""
        marks = {self.USABLE: CheckStatus.PASS, self.WITH_CARE: CheckStatus.WARNING}
        return marks.get(self, CheckStatus.FAIL)


SPOILING = re.compile(
    "no force|two clocks|peaks and valleys|displacement clipping|force sign|both signs|channels"
    "|time unit|duplicate|actuation|unit of displacement|unit of force|displacement"
    "|force|another device|beyond the priors"
)
"""Names of findings that say that something is wrong with a test: its results cannot be used."""


@dataclass(frozen=True)
class Finding:
    """A warning of a stage, which a reader of the results must know."""

    subject: str
    name: str
    message: Message
    stage: str = "records"

    @property
    def spoils(self) -> bool:
        """Whether something is wrong with the test, rather than to be kept in mind."""
        return SPOILING.fullmatch(self.name) is not None
