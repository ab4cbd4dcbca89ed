"""What a stage found that a reader of the results must know: a warning, with its subject."""

from __future__ import annotations

from dataclasses import dataclass

from mfd_bayes.messages import Message

SPOILING = frozenset(
    {
        *("no force", "force sign", "both signs", "channels", "time unit", "duplicate"),
        "actuation",
        *("unit of displacement", "unit of force", "displacement", "force", "another device"),
        "beyond the priors",
    }
)
"""Names of findings that say that something is wrong with a test: its results cannot be used."""


@dataclass(frozen=True)
class Finding:
    """A warning.

    Attributes
    ----------
    subject : str
        A test's id, or "laws".
    name : str
        Name of the fault, as `records.data_quality` and `records.cross_checks` have them.
    message : Message
        What was found, with figures and the likely cause.
    stage : {"records", "results"}
        Whether the records showed it before anything was fitted, or the results.
    """

    subject: str
    name: str
    message: Message
    stage: str = "records"

    @property
    def spoils(self) -> bool:
        """Whether something is wrong with the test, rather than to be kept in mind."""
        return self.name in SPOILING
