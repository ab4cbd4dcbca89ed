"""A small report, made without a sampler."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mfd_bayes.calibration.identifiability import (
    Directions,
    Identifiability,
    Pair,
    Sensitivity,
)
from mfd_bayes.evaluation.datasheet import Datasheet
from mfd_bayes.evaluation.views import (
    PREDICTIVE,
    CampaignView,
    Check,
    DerivedRow,
    Fan,
    Interval,
    Judgement,
    LawChoice,
    LawScoreRow,
    LawView,
    LeftOutRow,
    LeftOutView,
    Marginal,
    Row,
    ScoreRow,
    TestView,
    TruthRow,
)
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.messages import Message, Quantity
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.conversion import system_of
from mfd_bayes.reporting.figures import draw_shared, draw_test
from mfd_bayes.runs.verdict import Use, Verdict

THETA = (100, 0.05, 0.02, 1.3, 1.0, 1.5, 1.2, 0.5, 20, 0.1, 0.12, 1, 0.006, 0.5)
UNITS = {"Fc_fwd": "kip", "k3": "kip/in", "gamma1": "1"}


def make_fan(kind: str, draws: np.ndarray) -> Fan:
    lower, low, median, high, upper = np.quantile(draws, [0.025, 0.25, 0.5, 0.75, 0.975], axis=0)
    return Fan(kind, median, (Interval(0.5, low, high), Interval(0.95, lower, upper)))


def make_test(identity: str, role: str = "calibrate", samples: int = 250) -> TestView:
    rng = np.random.default_rng(7)
    time = np.arange(samples) / 25.0
    motion = np.sin(0.5 * np.pi * time)
    quiet = Trace.from_arrays(time, motion, 0.8)
    theta = np.array(THETA) * np.exp(0.03 * rng.normal(size=(60, 14)))
    theta[:, [3, 5]] = np.maximum(theta[:, [3, 5]], theta[:, [4, 6]])
    force = ThreeStage().force(theta, quiet)
    noisy = force + 0.05 * rng.normal(size=force.shape)
    trace = Trace.from_arrays(time, motion, 0.8, force=noisy[0])
    score = ScoreRow(identity, role, 0.5, 0.9, 0.95, 0.2, 0.25, 0.03, 0.09)
    draws = {name: np.exp(0.1 * rng.normal(size=60)) for name in UNITS}
    told = {"Fc_fwd": 0.99, "k3": 0.95, "gamma1": 0.0}
    view = TestView(
        id=identity,
        role=role,
        actuation="800 psi",
        trace=trace,
        first=5,
        device=make_fan("device", force),
        observation=make_fan("observation", noisy),
        rows=tuple(
            Row(identity, n, u, 1.0, 0.1, 0.8, 1.0, 1.2, 1.002, 900.0, 700.0, told[n])
            for n, u in UNITS.items()
        ),
        marginals=tuple(
            Marginal(n, u, np.exp(rng.normal(size=300)), draws[n], told[n])
            for n, u in UNITS.items()
        ),
        chains={name: rng.normal(size=(4, 40)) for name in ("Fc_fwd", "k3")},
        corner=("Fc_fwd", "k3"),
        checks=(
            Check(identity, "R-hat", "Fc_fwd", 1.002, 1.01, Verdict.PASS),
            Check(identity, PREDICTIVE, "energy", 3.3, 3.2, Verdict.PASS, "kip*in", p_value=0.4),
        ),
        score=score,
        derived=make_derived(identity, role),
    )
    if role == "validate":
        return replace(view, device=None, rows=(), marginals=(), chains={}, corner=(), checks=())
    return replace(view, identifiability=make_identifiability())


def make_derived(identity: str, role: str) -> tuple[DerivedRow, ...]:
    nan = float("nan")
    energy = DerivedRow(
        *(identity, role, "energy_per_cycle", "kip*in"),
        *(3.2, 0.1, 3.0, 3.21, 3.4, 3.3, "over 2 full cycles"),
    )
    none = replace(energy, mean=nan, sd=nan, lower=nan, median=nan, upper=nan, measured=nan)
    peak = DerivedRow(identity, role, "peak_fwd", "kip", 1.1, 0.01, 1.0, 1.123, 1.2, 1.4)
    gap = DerivedRow(identity, role, "gap", "in", 0.2, 0.01, 0.18, 0.2, 0.22, nan)
    if role == "validate":
        return (replace(none, note="the motion has no full cycle"), peak)
    return (energy, peak, gap)


def make_identifiability() -> Identifiability:
    names = ("Fc_fwd", "k3")
    axes = np.array([[0.8, 0.6], [0.6, -0.8]])
    return Identifiability(
        directions=Directions(names, np.array([399.0, 0.1]), axes),
        pairs=(Pair(*names, -0.84),),
        sensitivities=(
            Sensitivity("Fc_fwd", 0.012, 0.2),
            Sensitivity("k3", 0.09, 0.11),
        ),
    )


def make_law() -> LawView:
    level = np.linspace(0.0, 1.5, 20)
    draws = level * np.linspace(0.9, 1.1, 40)[:, None]
    tested = (("a", 0.8, 0.7, 0.8, 0.9), ("b", 0.8, 0.75, 0.85, 0.95))
    fans = (make_fan("device", draws), make_fan("new_test", 1.1 * draws))
    return LawView("Fc_fwd", "kip", "proportional", level, *fans, tested)


def make_choice() -> LawChoice:
    best = LawScoreRow("Fc_fwd", "power", False, 3.2, 0.9, 0.0, 0.0, 0.7, 0.25)
    own = LawScoreRow("Fc_fwd", "proportional", True, 2.9, 1.1, -0.3, 0.8, 0.3)
    return LawChoice("Fc_fwd", (best, own), "the power law predicts best, but only just.")


def make_left_out() -> LeftOutView:
    row = LeftOutRow("800 psi", "p800_f0.25", 0.5, 0.9, 0.95, 0.4, 0.45, 0.06, 0.2, 0.2, 0.03, 2, 2)
    mean = replace(row, part="", subject="mean")
    return LeftOutView("level", (row,), mean, "Of 1 tests the bands hold 95 %.")


def make_campaign(tests: tuple[TestView, ...]) -> CampaignView:
    row = Row("population", "K_c_fwd", "in**2", 1.2, 0.1, 1.0, 1.2, 1.4, 1.001, 900.0, 800.0, 0.98)
    return CampaignView(
        title="Drum brake",
        verdict=Use.USABLE,
        sentences=(Message("All checks passed."),),
        actuation_unit="ksi",
        tests=tests,
        failures={},
        laws=(make_law(),),
        law_rows=(row,),
        checks=tuple(check for test in tests for check in test.checks),
        scores=tuple(test.score for test in tests),
        truth=(
            TruthRow("a", "k3", "kip/in", 1.0, 0.8, 1.0, 1.2, inside=True, informed=True),
            TruthRow("a", "gamma1", "1", 1.0, 2.0, 3.0, 4.0, inside=False, informed=False),
            TruthRow("a", "offset", "kip", 0.0, -1.0, 0.0, 1.0, inside=True, informed=True),
        ),
        provenance={"seed": "1"},
        remarks=(Message("The data are synthetic."),),
        law_choices=(make_choice(),),
        left_out=make_left_out(),
        judgements=tuple(Judgement(test.id, Use.USABLE, (), 0.5) for test in tests if test.rows),
    )


@pytest.fixture(scope="session")
def test_view() -> Callable[..., TestView]:
    return make_test


def draw_pngs(view: CampaignView) -> dict[str, bytes]:
    system = system_of(view)
    pngs = dict(draw_shared(view))
    for test in view.tests:
        pngs |= draw_test(test, system, view.actuation_unit)
    return pngs


@pytest.fixture(scope="session")
def draw() -> Callable[[CampaignView], dict[str, bytes]]:
    """PNG of every figure of a report, by its key."""
    return draw_pngs


@pytest.fixture(scope="session")
def images(campaign: CampaignView) -> dict[str, bytes]:
    """PNG of every figure of `campaign`, by its key."""
    return draw_pngs(campaign)


@pytest.fixture(scope="session")
def campaign() -> CampaignView:
    return make_campaign((make_test("p800_f0.25"), make_test("held", "validate")))


def make_datasheet() -> Datasheet:
    """Two conditions, the second of which was not tested; a measured slip force is too large."""
    nan = float("nan")
    rows = []
    for at, level, tested in ((0, 0.8, True), (1, 1.0, False)):
        head = {"condition": f"c{at}", "actuation": level, "actuation_unit": "ksi"}
        head |= {"stroke": 1.0, "frequency": 0.5, "tested": tested}
        for quantity, direction, unit, cycle in (
            ("slip_force", "forward", "kip", 0),
            ("effective_damping", "", "1", 0),
            ("energy", "", "kip*in", 1),
        ):
            outside = tested and quantity == "slip_force"
            values = {"measured_low": 1.3, "measured": 1.35, "measured_high": 1.4}
            values = values if tested else dict.fromkeys(values, nan)
            rows.append(
                head
                | {"quantity": quantity, "direction": direction, "unit": unit, "cycle": cycle}
                | values
                | {"n_cycles": 3 * tested, "n_outside": int(outside), "nominal": 1.0}
                | {"lower": 0.8, "upper": 1.25, "lambda_min": 0.8, "lambda_max": 1.25}
                | {"note": "" if tested else "no test was made there"}
            )
    within = {"range": Quantity.of(0.8, unit="in")}
    return Datasheet(
        rows=pd.DataFrame(rows),
        measured=pd.DataFrame(),
        tested={"stroke": Message("{range}", within)},
        verdict=(
            Message("usable"),
            Message("1 of 3 lies outside"),
            Message("within {range}", within),
        ),
        not_known=(Message("Temperature: no record has one."),),
        formulas={"slip_force": "force at zero displacement"},
    )


@pytest.fixture(scope="session")
def datasheet() -> Datasheet:
    return make_datasheet()
