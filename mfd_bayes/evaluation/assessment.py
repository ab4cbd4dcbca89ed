"""What a run may be used for: its checks and its verdict, which a report stores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

from pydantic import ConfigDict, TypeAdapter, ValidationError

from mfd_bayes.errors import StoreError, hash_file
from mfd_bayes.messages import Measure, Message, Writer
from mfd_bayes.runs.findings import CheckStatus, Finding, Fitness
from mfd_bayes.runs.folder import ASSESSMENT, MANIFEST, check_stored
from mfd_bayes.runs.unit_system import UnitSystem
from mfd_bayes.store.files import read_json, write_text

FREE_EXPONENT = "exponent if the law were a power law"
SCATTER = "scatter between tests"
CONTRACTION = "prior variance removed"
DIRECTIONS = "directions informed"
PREDICTIVE = "posterior predictive"
LOOP_ESTIMATE = "estimate from the loop"
COVERAGE = "share of samples inside a band"
LENGTH = "autocorrelation times kept"
MODES = "modes found"
CALIBRATION = "calibration"
REPORT = "report"
IDENTIFIABILITY = (CONTRACTION, DIRECTIONS)
"""Names of the checks of what the data inform; beyond its limit such a check is a note."""
SAMPLING = ("R-hat", "bulk ESS", "tail ESS", LENGTH)
"""Names of the checks that say whether the sampling can be trusted."""

_NUMBERS = ConfigDict(ser_json_inf_nan="strings")  # JSON has neither NaN nor infinity
_LIMITS = {
    **dict.fromkeys(("bulk ESS", "tail ESS", LENGTH, CONTRACTION, DIRECTIONS), ">= {:g}"),
    "R-hat": "<= {:g}",
    FREE_EXPONENT: "interval holds {:g}",
    MODES: "{:g}",
}


@dataclass(frozen=True)
class Check:
    """One comparison of a value with what is expected of it, in `unit`.

    `test` is an id, or "population"; `check` and `feature` are such as "R-hat" of a parameter, or
    "posterior predictive" of a feature of a record. `expected` is the limit of a diagnostic, or
    the value of the model; `difference` expected less observed, as a share of what is measured;
    `tolerance` the difference up to which nobody minds. A figure that there is not is NaN.
    """

    __pydantic_config__ = _NUMBERS

    test: str
    check: str
    feature: str
    observed: float
    expected: float
    status: CheckStatus
    unit: str = "1"
    difference: float = float("nan")
    tolerance: float = float("nan")
    p_value: float = float("nan")
    note: str = ""

    @property
    def limit(self) -> str:
        """What passes, in words: "<= 1.01"."""
        return _LIMITS.get(self.check, "{:.3g}").format(self.expected)

    @property
    def message(self) -> Message:
        """The comparison as a sentence: "peak force forward 3.68 kip where 2.9 kip is expected"."""
        values: dict[str, Measure | str] = {"feature": self.feature}
        if self.check == COVERAGE:
            return Message(f"{{feature}}: {self.observed:.0%} of the samples are inside", values)
        for name, value in (("observed", self.observed), ("expected", self.expected)):
            has_unit = self.unit not in ("1", "dimensionless")
            values[name] = Measure.of(value, unit=self.unit) if has_unit else f"{value:.3g}"
        if self.check == PREDICTIVE:
            return Message(f"{self.feature} {{observed}} where {{expected}} is expected", values)
        return Message(f"{self.check} of {{feature}}: {{observed}} ({self.limit})", values)


@dataclass(frozen=True)
class Judgement:
    """What a test may be used for, and why.

    `reasons` have the worst first. Tests are ranked by `misfit`, in tolerances. `wrong` says if
    something is wrong with its record or its fit, and not only with its sampling; `notes` are what
    a reader must know besides, no reason for distrust.
    """

    __pydantic_config__ = _NUMBERS

    subject: str
    use: Fitness
    reasons: tuple[Message, ...]
    misfit: float
    wrong: bool = False
    notes: tuple[Message, ...] = ()

    def to_text(self, writer: Writer) -> str:
        """Reasons and notes in a reader's units; "" where there are none."""
        return "; ".join(m.to_text(writer) for m in (*self.reasons, *self.notes))


@dataclass(frozen=True, eq=False)
class Assessment:
    """What a run may be used for.

    `verdict` and `sentences`, the worst first, say what the run may be used for, and `judgements`
    what each calibrated test, the one to believe least first.
    """

    verdict: Fitness
    sentences: tuple[Message, ...]
    checks: tuple[Check, ...]
    judgements: tuple[Judgement, ...] = ()
    warnings: tuple[Finding, ...] = ()

    @property
    def unusable(self) -> bool:
        """Whether the run must not be used: a check failed, or something is wrong with a test."""
        return self.verdict == Fitness.NOT_USABLE


@dataclass(frozen=True, eq=False)
class _Stored:
    """An assessment with the units of its run, and hashes of what it is of."""

    manifest: str
    files: dict[str, str]
    system: UnitSystem
    assessment: Assessment


def write_assessment(
    folder: Path, assessment: Assessment, files: Mapping[str, str], system: UnitSystem
) -> None:
    """Store the assessment of a run: of its manifest in the folder, and of its stored files."""
    values = {field.name: getattr(assessment, field.name) for field in fields(Assessment)}
    stored = _Stored(hash_file(folder / MANIFEST), dict(files), system, Assessment(**values))
    write_text(folder / ASSESSMENT, TypeAdapter(_Stored).dump_json(stored).decode())


def stored_assessment(folder: Path) -> tuple[Assessment, UnitSystem] | None:
    """The assessment in a run folder, and the units of the run; None where the run has changed.

    Raises StoreError where a file of the run is missing or is not what it wrote.
    """
    try:
        stored = TypeAdapter(_Stored).validate_python(read_json(folder / ASSESSMENT))
        if stored.manifest != hash_file(folder / MANIFEST):
            return None
    except (OSError, StoreError, ValidationError):
        return None
    for name in stored.files:
        check_stored(folder, name, stored.files)
    return stored.assessment, stored.system
