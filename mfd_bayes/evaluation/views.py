"""What a report shows, in internal units.

Tables are records, one dict for each row, all with the same keys. The keys that several tables
have: `test`, `name` and `unit` of a quantity; `mean`, `sd`, and `lower`, `median` and `upper`, its
2.5 %, 50 % and 97.5 % quantile; `note`, what a reader must know of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Identifiability
from mfd_bayes.evaluation.assessment import REPORT, Assessment, Check
from mfd_bayes.evaluation.scores import QuantileBand, Row, Rows
from mfd_bayes.friction.model import Model
from mfd_bayes.messages import Message
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Comparison
from mfd_bayes.runs.tested_range import Range
from mfd_bayes.runs.unit_system import SYSTEMS, UnitSystem

if TYPE_CHECKING:
    import pandas as pd


Array = NDArray[np.float64]

INFORMED = 0.5  # least contraction of a parameter that the data inform
NOT_INFORMED = "the data do not determine this parameter: its posterior is about its prior"
"""Note of a parameter with less contraction."""

DEFAULT_LIMITS: Mapping[str, float] = {"all": 0.15}
"""Of a device against the others where neither campaign nor standard has any: of no standard."""


@dataclass(frozen=True, eq=False)
class Marginal:
    """Draws of one quantity from prior (m,) and posterior (n,), in `unit`."""

    name: str
    unit: str
    prior: Array
    posterior: Array
    contraction: float


@dataclass(frozen=True, eq=False)
class TestView:
    """One test in the report; a test that was held out has no parameters.

    `role` is "calibrate" or "validate"; `first` the first fitted sample; `device` the fan of this
    very test, without noise. Scores are those of a table. `rows` are posteriors of each
    quantity with R-hat, ESS, contraction and its joint posterior with all tests; `corner` the
    quantities of the corner plot, in its order; `derived` the properties, with those of the record
    as recorded; `loop_estimates` what a plain rule reads off the loop and off replicated records;
    each of `modes` has the median of each quantity and its "share" of the draws. `stage` (1 slip,
    2 stick, 3 build-up, 4 gap) and `travel` in the gap since the last slip, in, are those of the
    posterior medians at each sample, (T,); None where the model has no gap. `shares` of each source
    in the variance say what makes the band of a predicted test wide, and `begun` where in its gap
    that begins, in words.
    """

    __test__ = False

    id: str
    role: str
    trace: Trace
    first: int
    observation: QuantileBand
    score: Row
    device: QuantileBand | None = None
    rows: Rows = ()
    marginals: tuple[Marginal, ...] = ()
    chains: int = 0
    corner: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()
    identifiability: Identifiability | None = None
    derived: Rows = ()
    stage: NDArray[np.int8] | None = None
    travel: Array | None = None
    shares: Mapping[str, float] = field(default_factory=dict)
    loop_estimates: Rows = ()
    modes: tuple[Mapping[str, float], ...] = ()
    begun: str = ""
    sensitivity: Rows = ()  # whether its parameters follow the prior


@dataclass(frozen=True, eq=False)
class LawView:
    """A quantity against actuation, (m,), ksi or kip: its law's bands, and the tests' posteriors.

    `law` is its name, or the weights of several; `device` the fan of the mean property, by law and
    level effect without scatter from test to test, `new_test` that of one more test, with it.
    `tested` has id, actuation, and 2.5 %, 50 % and 97.5 % quantile of each test.
    """

    name: str
    unit: str
    law: str
    actuation: Array
    device: QuantileBand
    new_test: QuantileBand
    tested: tuple[tuple[str, float, float, float, float], ...]


@dataclass(frozen=True)
class LeftOutView:
    """Cross-validation of a campaign: each part predicted from all the others.

    `rows` are the scores of each test, beside those of its own fit, and `mean` is the mean of each.
    """

    by: str
    rows: Rows
    mean: Row
    sentence: str


_AFTER = {
    "date": "ten years later",
    "cycles": "after ten times the cycles",
    "temperature": "ten times as far",
}


@dataclass(frozen=True)
class DriftRow:
    """Change of a quantity along a condition of the tests."""

    # `per` is what the change is for: "year"
    quantity: str
    condition: str
    per: str
    # per cent: median and 95 % interval
    change: float
    lower: float
    upper: float
    probability: float  # that there is a change in the direction of the median
    limit: float  # per cent, from the value at the earliest date, the least count or temperature
    left: float  # probability that the quantity has left its limit at the last test
    leaves: float  # probability that it does within `laws.AHEAD` after it
    # when it does: median and 90 % interval; "" where it is later than that
    when: str
    when_lower: str
    when_upper: str

    @property
    def found(self) -> bool:
        """Whether the 95 % interval has no zero in it."""
        return self.lower > 0.0 or self.upper < 0.0

    @property
    def sentence(self) -> str:
        """The change, and when it is too much, in words."""
        text = (
            f"{self.change:+.2g} % per {self.per} (95 % interval {self.lower:+.2g} to "
            f"{self.upper:+.2g} %)"
        )
        if not self.found:
            text += ", which may be none"
        when = f" (median: {self.when})" if self.when else ""
        return (
            f"{text}. At the last test it has left ±{self.limit:.0f} % with a probability of "
            f"{self.left:.2f}; {_AFTER[self.condition]} it will have with {self.leaves:.2f}{when}."
        )


@dataclass(frozen=True, eq=False)
class Datasheet:
    """What an engineer needs to use a device, in internal units.

    `rows` has one for each condition, quantity, direction and cycle (0: all cycles at full stroke).
    `stroke` is the amplitude of the motion. `measured` is the value of a test, by the formula of
    the quantity, and the mean of several; `measured_low` and `measured_high` are its smallest and
    its largest cycle, NaN where nothing was tested. `nominal` is the mean of the mean property (the
    device at this actuation). `lower` and `upper` hold what `of` says, the value of a measured
    test, with 95 %, offset, noise and chatter included: `n_outside` of `n_tests` lie outside.
    `first_three` is the mean of the first three cycles of a test, the nominal value of standards.
    `lower_ratio` and `upper_ratio` are the bounds over `nominal`, `lower_ratio_other` and
    `upper_ratio_other` those of another device tested: NaN where all tests are of one.
    `sensitivity` says of nominal values and bounds whether they follow the prior.
    """

    rows: pd.DataFrame
    cycles: pd.DataFrame  # measured values of each cycle at full stroke of each harmonic test
    tested: Mapping[str, Message]  # ranges and numbers of what was tested, by name
    verdict: tuple[Message, ...]  # three; a fourth of other devices, where there are several
    not_known: tuple[Message, ...]  # what a standard asks for and these tests cannot tell
    formulas: Mapping[str, str]  # how each quantity is computed
    sensitivity: Rows = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class CampaignView(Assessment):
    """The whole report.

    `failures` are tests without a result, and why. `law_rows` are constants of the laws, their
    shapes, and the scatter of each quantity; `common` the quantities with one value for all tests;
    `law_scores` how well each law predicts levels that were left out, the best first, and
    `law_choices` that in sentences. `truth` are the true values of a synthetic campaign: whether
    `inside` the interval, and `informed` by data. `metric` says which of both `systems` the report
    begins with, `tested` what the calibrated tests cover, `drifts` what follows a date, a count of
    cycles or a temperature.
    """

    title: str
    actuation_unit: str
    tests: tuple[TestView, ...]
    failures: Mapping[str, str]
    laws: tuple[LawView, ...]
    law_rows: Rows
    truth: Rows
    provenance: Mapping[str, str]
    remarks: tuple[Message, ...]
    common: tuple[str, ...] = ()
    law_scores: Rows = ()
    law_choices: Mapping[str, str] = field(default_factory=dict)
    left_out: LeftOutView | None = None
    comparison: Comparison | None = None
    metric: bool = False
    systems: tuple[UnitSystem, UnitSystem] = SYSTEMS
    tested: tuple[Range, ...] = ()
    drifts: tuple[DriftRow, ...] = ()
    sensitivity: Rows = ()  # whether constants of the laws follow the prior
    model: Model | None = None

    @property
    def whole(self) -> bool:
        """Whether it shows every test that it could."""
        return all(check.check != REPORT for check in self.checks)

    @property
    def system(self) -> UnitSystem:
        """System of units of figures and tables: by default the campaign's own."""
        return self.systems[self.metric]
