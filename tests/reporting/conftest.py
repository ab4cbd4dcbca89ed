"""A small report, made without a sampler."""

from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mfd_bayes.calibration.diagnostics import Directions, Identifiability, Pair
from mfd_bayes.evaluation.assessment import PREDICTIVE, Check, Judgement
from mfd_bayes.evaluation.scores import Interval, QuantileBand
from mfd_bayes.evaluation.views import (
    CampaignView,
    Datasheet,
    LawView,
    LeftOutView,
    Marginal,
    TestView,
)
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.messages import Measure, Message
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.options import ReportOptions
from mfd_bayes.reporting.page import publish
from mfd_bayes.runs.findings import CheckStatus, Fitness

THETA = (100, 0.05, 0.02, 1.3, 1.0, 1.5, 1.2, 0.5, 20, 0.1, 0.12, 1, 0.006, 0.5)
UNITS = {"Fc_fwd": "kip", "k3": "kip/in", "gamma1": "1"}


def make_fan(kind: str, draws: np.ndarray) -> QuantileBand:
    lower, low, median, high, upper = np.quantile(draws, [0.025, 0.25, 0.5, 0.75, 0.975], axis=0)
    return QuantileBand(kind, median, (Interval(0.5, low, high), Interval(0.95, lower, upper)))


SCORES = {"coverage_50": 0.5, "coverage_90": 0.9, "coverage_95": 0.95, "width_95": 0.2}
SCORES |= {"interval_score": 0.25, "crps": 0.03, "rrse": 0.09}
NAN = float("nan")


def make_row(test: str, name: str, unit: str, lower=0.8, median=1.0, upper=1.2, **fields) -> dict:
    row = {"test": test, "name": name, "unit": unit, "mean": median, "sd": 0.1}
    row |= {"lower": lower, "median": median, "upper": upper, "note": ""}
    row |= {"r_hat": 1.002, "ess_bulk": 900.0, "ess_tail": 700.0, "contraction": 0.98}
    row |= dict.fromkeys(("joint_lower", "joint_median", "joint_upper"), NAN)
    return row | {"joint_conflict": False} | fields


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
    score = {"test": identity, "role": role} | SCORES
    draws = {name: np.exp(0.1 * rng.normal(size=60)) for name in UNITS}
    contraction = {"Fc_fwd": 0.99, "k3": 0.95, "gamma1": 0.0}
    view = TestView(
        id=identity,
        role=role,
        trace=trace,
        first=5,
        device=make_fan("mean", force),
        observation=make_fan("observation", noisy),
        rows=tuple(make_row(identity, n, u, contraction=contraction[n]) for n, u in UNITS.items()),
        marginals=tuple(
            Marginal(n, u, np.exp(rng.normal(size=300)), draws[n], contraction[n])
            for n, u in UNITS.items()
        ),
        chains=4,
        corner=("Fc_fwd", "k3"),
        checks=(
            Check(identity, "R-hat", "Fc_fwd", 1.002, 1.01, CheckStatus.PASS),
            Check(
                identity, PREDICTIVE, "energy", 3.3, 3.2, CheckStatus.PASS, "kip*in", p_value=0.4
            ),
        ),
        score=score,
        derived=make_derived(identity, role),
    )
    if role == "validate":
        return replace(view, device=None, rows=(), marginals=(), chains=0, corner=(), checks=())
    names, axes = ("Fc_fwd", "k3"), np.array([[0.8, 0.6], [0.6, -0.8]])
    directions = Directions(names, np.array([399.0, 0.1]), axes)
    return replace(view, identifiability=Identifiability(directions, (Pair(*names, -0.84),)))


def make_derived(identity: str, role: str) -> tuple[dict, ...]:
    fields = {"role": role, "missed": False}
    energy = {"measured": 3.3, "note": "over 2 full cycles"} | fields
    blank = {
        "measured": NAN,
        "note": "the motion has no full cycle",
        "mean": NAN,
        "sd": NAN,
    } | fields
    peak = make_row(identity, "peak_fwd", "kip", 1.0, 1.123, 1.2, measured=1.4, **fields)
    gap = make_row(identity, "gap", "in", 0.18, 0.2, 0.22, measured=NAN, **fields)
    of_cycle = identity, "energy_per_cycle", "kip*in"
    if role == "validate":
        return (make_row(*of_cycle, NAN, NAN, NAN, **blank), peak)
    return (make_row(*of_cycle, 3.0, 3.21, 3.4, **energy), peak, gap)


def make_campaign(tests: tuple[TestView, ...]) -> CampaignView:
    row = make_row("population", "K_c_fwd", "in**2", 1.0, 1.2, 1.4)
    level = np.linspace(0.0, 1.5, 20)
    draws = level * np.linspace(0.9, 1.1, 40)[:, None]
    tested = (("a", 0.8, 0.7, 0.8, 0.9), ("b", 0.8, 0.75, 0.85, 0.95))
    fans = (make_fan("mean", draws), make_fan("new_test", 1.1 * draws))
    best = {"quantity": "Fc_fwd", "law": "power", "chosen": False, "elpd": 3.2, "elpd_se": 0.9}
    best |= {"difference": 0.0, "difference_se": 0.0, "weight": 0.7, "pareto_k": 0.25}
    prediction = {"part": "800 psi", "test": "p800_f0.25", "simultaneous_95": NAN} | SCORES
    prediction |= {"fitted_width": 0.2, "fitted_crps": 0.03, "width_ratio": 2.0, "crps_ratio": 2.0}
    mean = prediction | {"part": "", "test": "mean"}
    return CampaignView(
        title="Drum brake",
        verdict=Fitness.USABLE,
        sentences=(Message("All checks passed."),),
        actuation_unit="ksi",
        tests=tests,
        failures={},
        laws=(LawView("Fc_fwd", "kip", "proportional", level, *fans, tested),),
        law_rows=(row,),
        checks=tuple(check for test in tests for check in test.checks),
        truth=(
            make_row("a", "k3", "kip/in", truth=1.0, inside=True, informed=True),
            make_row("a", "gamma1", "1", 2.0, 3.0, 4.0, truth=1.0, inside=False, informed=False),
            make_row("a", "offset", "kip", -1, 0.0, 1.0, truth=0.0, inside=True, informed=True),
        ),
        provenance={"seed": "1"},
        remarks=(Message("The data are synthetic."),),
        law_scores=(best, best | {"law": "proportional", "chosen": True, "difference": -0.3}),
        law_choices={"Fc_fwd": "the power law predicts best, but only just."},
        left_out=LeftOutView("level", (prediction,), mean, "Of 1 tests the bands hold 95 %."),
        judgements=tuple(
            Judgement(test.id, Fitness.USABLE, (), 0.5) for test in tests if test.rows
        ),
    )


@pytest.fixture(scope="session")
def test_view() -> Callable[..., TestView]:
    return make_test


@pytest.fixture(scope="session")
def campaign() -> CampaignView:
    return make_campaign((make_test("p800_f0.25"), make_test("held", "validate")))


@pytest.fixture(scope="session")
def datasheet() -> Datasheet:
    """Two conditions, the second of which was not tested; a measured slip force is too large."""
    rows = []
    for index, level, tested in ((0, 0.8, True), (1, 1.0, False)):
        head = {"condition": f"c{index}", "actuation": level, "actuation_unit": "ksi"}
        head |= {"stroke": 1.0, "frequency": 0.5, "speed": 3.14, "tested": tested}
        head |= {"n_cycles": 3 * tested, "n_tests": int(tested), "n_outside": 0, "nominal": 1.0}
        head |= {"lower": 0.8, "upper": 1.25, "lower_ratio": 0.8, "upper_ratio": 1.25}
        head |= {"first_three": 1.3 if tested else NAN}
        head |= {"note": "" if tested else "no test was made there"}
        measured = (1.3, 1.35, 1.4) if tested else (NAN, NAN, NAN)
        head |= dict(zip(("measured_low", "measured", "measured_high"), measured, strict=True))
        slip = {"quantity": "slip_force", "direction": "forward", "unit": "kip", "cycle": 0}
        damping = slip | {"quantity": "effective_damping", "direction": "", "unit": "1"}
        energy = damping | {"quantity": "energy", "unit": "kip*in", "cycle": 1}
        rows += [head | slip | {"n_outside": int(tested)}, head | damping, head | energy]
    values = {"range": Measure.of(0.8, unit="in")}
    verdict = Message("usable"), Message("1 of 3 lies outside"), Message("within {range}", values)
    return Datasheet(
        rows=pd.DataFrame(rows),
        cycles=pd.DataFrame([{"test": "p800_f0.25", "cycle": 1, "unit": "kip*in", "value": 4.0}]),
        tested={"stroke": Message("{range}", values)},
        verdict=verdict,
        not_known=(Message("Temperature: no record has one."),),
        formulas={"slip_force": "force at zero displacement"},
    )


@pytest.fixture(scope="session")
def published(campaign, datasheet, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("published")
    forms = {"word": bool(find_spec("docx")), "excel": bool(find_spec("openpyxl"))}
    publish(campaign, ReportOptions(folder, **forms), 1, lambda _: None, datasheet)
    return folder


@pytest.fixture
def written(tmp_path, no_figures) -> Callable[..., dict[str, str]]:
    """Function that writes a report without its figures; the texts of its files, by their names."""

    def written(view: CampaignView, sheet: Datasheet | None = None, **forms: bool):
        publish(view, ReportOptions(tmp_path, **forms), 1, lambda _: None, sheet)
        paths = [p for p in tmp_path.rglob("*.*") if p.suffix in (".csv", ".json", ".tex", ".html")]
        return {str(p.relative_to(tmp_path)): p.read_text("utf-8") for p in paths}

    return written
