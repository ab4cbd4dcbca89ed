"""What a test may be used for."""

from __future__ import annotations

from dataclasses import dataclass

from mfd_bayes.runs.verdict import Use


@dataclass(frozen=True)
class Judgement:
    """What a test may be used for, and why.

    Attributes
    ----------
    sentence : str
        Reasons, the worst first; "" where there are none.
    doubt : float
        By which tests are ranked, the largest first; 1 is a miss as large as its tolerance.
    wrong : bool
        Whether something is wrong with its record or its fit, and not only with its sampling.
    notes : str
        What a reader must know besides, which is no reason for doubt; "" where there is nothing.
    """

    subject: str
    use: Use
    sentence: str
    doubt: float
    wrong: bool = False
    notes: str = ""

    @property
    def told(self) -> str:
        """Reasons and notes together; "" where there are none."""
        return "; ".join(part for part in (self.sentence, self.notes) if part)
