"""What is to be known better, and tests that could be made for it, in words and in numbers."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np

from mfd_bayes.errors import CampaignError, UnitError, real_number
from mfd_bayes.population.design import (
    SAME_LEVEL,
    TestConditions,
    default_laws,
    levels_of,
    same_level,
    setting_of,
)
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.trace import MOST_CYCLES, Trace
from mfd_bayes.store.files import nearest
from mfd_bayes.units import ActuationUnit, actuation_kind, measure, parse_actuation, parse_quantity

SETUP = 0.25  # time on the frame besides the motion itself, h
NEW_DEVICE = "a new device"  # of a candidate
WAVEFORMS = ("sine", "triangle")
MOST = 1000  # most candidates of one question
BEYOND = 1.25  # how far candidates go beyond the largest tested actuation, amplitude and frequency
LEVELS = 9  # most actuations of candidates
RANGE = 5  # actuations over which the campaign's range is averaged
ALIKE = 0.1  # share of amplitude and frequency within which a test at the same level is a repeat
NEAR, NEW = 0.005, 0.02  # shares by which figures of tests, and of new ones, are rounded
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.ASCII)
_ALTERNATIVES = re.compile(r"([^a-zA-Zµμ%°]*\|[^a-zA-Zµμ%°]*)(.*)", re.ASCII)
_LONGEST = 20_000
_RANGES = {
    "actuation": (0.0, np.inf, False),
    "frequency": (0.0, np.inf, True),
    "amplitude": (0.0, np.inf, True),
    "cycles": (1.0, float(MOST_CYCLES), False),
    "price": (0.0, np.inf, False),
}
# quantities at stated motions and actuations, and what they are
AT_MOTIONS = {
    "band": "force along the loop",
    "energy": "energy per cycle",
    "peak": "peak forces",
    "peak_fwd": "peak force forward",
    "peak_bwd": "peak force backward",
    "slip": "slip forces",
}
OF_LAWS = {"slope": "slope of a law", "exponent": "exponent of a law"}
GAP = "gap"
KINDS = ("mean", "new_test")
_FORM = re.compile(
    r"\s*(?P<name>[A-Za-z_]+(?: force)?)(?:\s+of\s+(?P<of>\w+))?(?:\s+at\s+(?P<at>.+))?\s*",
    re.DOTALL,
)


# --- tests ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Candidate:
    """A test that could be made.

    Attributes
    ----------
    actuation : float, ksi or kip
    frequency : float, Hz
    amplitude : float, in
        Half the stroke.
    cycles : float
    waveform : {"sine", "triangle"}
        A triangle has one speed.
    price : float or None, h
        What it costs, where the user says so.
    device : str
        A tested device or `NEW_DEVICE`, where the campaign has several; else empty.

    Raises
    ------
    CampaignError
        When a number is none or out of its range, or the waveform is unknown.
    """

    actuation: float
    frequency: float
    amplitude: float
    cycles: float = 3.0
    waveform: str = "sine"
    price: float | None = None
    device: str = ""

    def __post_init__(self) -> None:
        for name, (low, high, strict) in _RANGES.items():
            value, label = getattr(self, name), f"{name} of a test"
            if name != "price" or value is not None:
                number = real_number(label, value, CampaignError, (low, high), exclusive=strict)
                object.__setattr__(self, name, number)
        if self.waveform not in WAVEFORMS:
            raise CampaignError(
                f"waveform of a test must be {' or '.join(WAVEFORMS)}, got {self.waveform!r}"
            )

    @property
    def cost(self) -> float:
        """What it costs, h: the given price, or `SETUP` and the time of the motion."""
        return SETUP + self.cycles / self.frequency / 3600.0 if self.price is None else self.price

    @property
    def stroke(self) -> float:
        """From one end of the motion to the other, in."""
        return 2.0 * self.amplitude

    @property
    def speed(self) -> float:
        """Peak speed, in/s."""
        scale = 4.0 if self.waveform == "triangle" else 2.0 * np.pi
        return float(scale * self.frequency * self.amplitude)


@dataclass(frozen=True)
class Limits:
    """What the actuator of the frame can do; None where there is no limit.

    Attributes
    ----------
    velocity : float, in/s
    stroke : float, in
        From one end of the motion to the other.
    force : float, kip

    Raises
    ------
    CampaignError
        When a value is no number above zero.
    """

    velocity: float | None = None
    stroke: float | None = None
    force: float | None = None

    def __post_init__(self) -> None:
        for name, value in dict(vars(self)).items():
            if value is not None:
                label, bounds = f"limit of the {name}", (0.0, np.inf)
                number = real_number(label, value, CampaignError, bounds, exclusive=True)
                object.__setattr__(self, name, number)

    def forbids(self, candidate: Candidate) -> str:
        """The limit that its motion passes, or ""; its force is known only once simulated.

        Raises
        ------
        CampaignError
            When it is no candidate.
        """
        if not isinstance(candidate, Candidate):
            raise CampaignError(f"candidate must be a Candidate, got {candidate!r}")
        sizes = {"velocity": candidate.speed, "stroke": candidate.stroke}
        limits = {name: getattr(self, name) for name in sizes}
        return next((n for n, m in limits.items() if m and sizes[n] > m * (1 + 1e-9)), "")


@dataclass(frozen=True)
class Parts:
    """Parts of a test that a text gives; None where it is silent."""

    actuation: float | None = None
    frequency: float | None = None
    amplitude: float | None = None
    cycles: float | None = None
    waveform: str | None = None
    price: float | None = None
    device: str | None = None

    def completed(self, typical: Candidate) -> Candidate:
        """The test, with the parts of a typical one where it has none."""
        values = {name: value for name, value in vars(self).items() if value is not None}
        return Candidate(**(vars(typical) | {"price": None} | values))


def parse_limits(text: str, *, of: str = "--limits") -> Limits:
    """Limits of ``"10 in/s, 6 in, 20 kip"``: velocity, stroke and force, in any order."""
    limits: dict[str, float] = {}
    form = f"{of}: limits read '10 in/s, 6 in, 20 kip' (velocity, stroke, force), got {text!r}"
    kinds = {"velocity": ("velocity", "velocity"), "length": ("stroke", "displacement")}
    for term in text.split(","):
        name, dimension = kinds.get(_measured(term), ("force", "force"))
        try:
            value = parse_quantity(term, dimension)
        except UnitError as error:
            raise CampaignError(f"{form}: {error}") from error
        if name in limits or not value > 0.0:
            reason = "is there twice" if name in limits else "must be above zero"
            raise CampaignError(f"{form}: the {name} {reason}")
        limits[name] = value
    return Limits(**limits)


def parse_tests(
    text: str | Sequence[str], unit: ActuationUnit, *, of: str = "--candidates"
) -> list[Parts]:
    """Tests of ``"500|1000 psi, 0.5 Hz, 1 in; 1350 psi, 0.1 Hz, 1 in, triangle, 2 h"``.

    Semicolons, or the items of a list, are between tests; a part with bars gives a test for each
    of its values. The parts are told apart by their units: actuation, frequency, amplitude (half
    the stroke), cycles, waveform, and the cost as a time.
    """
    form = f"{of}: a test reads '1000 psi, 0.5 Hz, 1 in, 3 cycles'"
    if not isinstance(text, str) and not all(isinstance(term, str) for term in text):
        raise CampaignError(f"{form}, got {text!r}")
    joined = text if isinstance(text, str) else ";".join(text)
    if len(joined) > _LONGEST:
        raise CampaignError(f"{of}: longer than {_LONGEST} characters")
    tests: list[Parts] = []
    for test in filter(str.strip, joined.split(";")):
        choices = []
        for term in map(str.strip, test.split(",")):
            match = _ALTERNATIVES.fullmatch(term)
            values, suffix = (match[1], f" {match[2]}") if match else (term, "")
            choices.append([f"{value.strip()}{suffix}" for value in values.split("|")])
        for texts in product(*choices):
            fields: dict[str, Any] = {}
            for term in texts:
                try:
                    name, value = _part(term, unit)
                except UnitError as error:
                    raise CampaignError(f"{form}, got {', '.join(texts)!r}: {error}") from error
                if name in fields:
                    raise CampaignError(f"{form}, got two values of the {name}: {test.strip()!r}")
                fields[name] = value
            tests.append(Parts(**fields))
            if len(tests) > MOST:
                raise CampaignError(f"{of}: more than {MOST} tests, the most of one question")
    if not tests:
        raise CampaignError(f"{form}, got {joined[:80]!r}")
    return tests


def _part(text: str, unit: ActuationUnit) -> tuple[str, float | str]:
    """Name and value of one part of a test."""
    if text in WAVEFORMS:
        return "waveform", text
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise UnitError(
            f"{text!r} is no number with a unit, and no waveform ({', '.join(WAVEFORMS)})"
        )
    if match[2] in ("cycle", "cycles"):
        if not 1.0 <= float(match[1]) <= MOST_CYCLES:
            raise UnitError(f"a test has 1 to {MOST_CYCLES} cycles, not {text!r}")
        return "cycles", float(match[1])
    kinds = {
        "length": ("amplitude", "displacement"),
        "time": ("price", "time"),
        "rate": ("frequency", "rate"),
    }
    if (kind := _measured(text)) not in kinds:
        level, level_unit = parse_actuation(text)
        if level_unit != unit:
            raise UnitError(f"the campaign's actuation is {actuation_kind(unit)}, {text!r} is not")
        return "actuation", level
    name, dimension = kinds[kind]
    value = parse_quantity(text, dimension)
    if not 0.0 < value < 1e9:
        raise UnitError(f"{text!r} must be above zero, and not too large")
    return name, value / 3600.0 if name == "price" else value


def _measured(text: str) -> str:
    """What the unit of a text measures; "" where it has none."""
    match = _NUMBER.fullmatch(text)
    return (measure(match[2]) if match else None) or ""


@dataclass(frozen=True)
class Shown:
    """Factors from internal units to those in which a campaign shows and rounds its tests."""

    actuation: float = 1.0
    length: float = 1.0
    actuated: bool = True
    timed: bool = True


def harmonic_of(trace: Trace, display: Shown = Shown()) -> Candidate:
    """The harmonic test with the actuation, half stroke and frequency of a record.

    One of which most loops are not at full stroke has that of the same peak speed instead.
    """
    setting, loops = setting_of(trace), find_loops(trace)
    amplitude = setting.covariates["amplitude"]
    if not trace.timed:
        frequency = 1.0
    elif 2 * np.count_nonzero(loops.strong) > loops.period.size:
        frequency = float(1.0 / np.median(loops.period[loops.strong]))
    else:  # an earthquake
        frequency = setting.covariates["velocity"] / (2.0 * np.pi * amplitude)
    return Candidate(
        setting.actuation,
        _round(frequency, NEAR),
        _round(amplitude, NEAR, display.length),
        float(np.clip(loops.period.size, 1, 100)),
    )


def typical_of(tests: Sequence[Candidate]) -> list[Candidate]:
    """The campaign's range: `RANGE` actuations, each with the tests' median motion."""
    levels = [test.actuation for test in tests]
    low, high = min(levels), max(levels)
    count = RANGE if high > low * (1.0 + SAME_LEVEL) else 1
    motions = [(test.frequency, test.amplitude, test.cycles) for test in tests]
    frequency, amplitude, cycles = np.median(motions, axis=0).tolist()
    return [
        Candidate(level, frequency, amplitude, max(1.0, round(cycles)))
        for level in np.linspace(low, high, count).tolist()
    ]


def grid_of(tests: Sequence[Candidate], display: Shown = Shown()) -> list[Candidate]:
    """Every test once more, and candidates from the campaign's range and a little beyond it."""
    cycles, scale = typical_of(tests)[0].cycles, display.actuation
    # tested levels, one in the middle of each gap between them, and one beyond
    levels = levels_of([TestConditions(test.actuation) for test in tests])
    tested = [tests[group[0]].actuation for group in levels]
    if len(tested) > (limit := (LEVELS - 1) // 2):
        tested = [
            tested[k] for k in np.unique(np.linspace(0, len(tested) - 1, limit).round().astype(int))
        ]
    new_levels = [0.5 * (a + b) for a, b in pairwise(tested)] + [BEYOND * tested[-1]]
    new_levels += [tested[0] / BEYOND] if len(tested) == 1 else []
    if not display.actuated:
        new_levels = []
    actuations = sorted({*tested, *(_round(level, NEW, scale) for level in new_levels)} - {0.0})
    # smallest and largest tested value, and one beyond
    motions = []
    for name, factor in (("frequency", 1.0), ("amplitude", display.length)):
        values = [getattr(test, name) for test in tests]
        low, high = min(values), max(values)
        ends = [low] if low > 0.9 * high else [low, high]
        extra = (
            []
            if name == "frequency" and not display.timed
            else [_round(BEYOND * high, NEW, factor)]
        )
        motions.append([*ends, *extra])
    again: list[Candidate] = []
    for test in tests:
        if test.actuation > 0.0 and not repeats(test, again, NEW):
            again.append(replace(test, cycles=cycles))
    candidates = (Candidate(p, f, a, cycles) for p, f, a in product(actuations, *motions))
    return [*again, *(c for c in candidates if not repeats(c, again))]


def repeats(candidate: Candidate, tests: Iterable[Candidate], tolerance: float = ALIKE) -> bool:
    """Whether a candidate is like a test that was made."""
    return any(
        same_level(candidate.actuation, test.actuation)
        and candidate.device != NEW_DEVICE
        and candidate.waveform == test.waveform
        and abs(candidate.frequency / test.frequency - 1.0) <= tolerance
        and abs(candidate.amplitude / test.amplitude - 1.0) <= tolerance
        for test in tests
    )


def _round(value: float, tolerance: float, scale: float = 1.0) -> float:
    """A value to two digits in the unit of a scale, as it is set on a frame; else to three.

    Three where two are off by more than a share of the value.
    """
    scaled = scale * value
    short = float(f"{scaled:.2g}")
    return (
        short if abs(short - scaled) <= tolerance * abs(scaled) else float(f"{scaled:.3g}")
    ) / scale


# --- goals ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Goal:
    """What is to be known better of a new device.

    Attributes
    ----------
    quantity : str
        A key of `AT_MOTIONS` or `OF_LAWS`, or "gap".
    of : str
        Quantity whose law is meant; "" for others.
    kind : {"mean", "new_test"}
        Of the band: of the mean property, or with test-to-test scatter, of which no test can take
        anything away.
    at : tuple of Parts or Candidate
        Motions and actuations; none for the campaign's range.
    probability : float
        Of the band.
    session : str
        Session that it is about, where the campaign declares several; "" for a new one.

    Raises
    ------
    CampaignError
        When a value is of another type, or the probability is not between 0 and 1.
    """

    quantity: str = "band"
    of: str = ""
    kind: str = "mean"
    at: tuple[Parts, ...] = ()
    probability: float = 0.95
    session: str = ""

    def __post_init__(self) -> None:
        for name in ("quantity", "of", "kind", "session"):
            if not isinstance(value := getattr(self, name), str):
                raise CampaignError(f"{name} of a goal must be text, got {value!r}")
        bounds, raw = (0.0, 1.0), self.at
        real_number(
            "probability of a goal", self.probability, CampaignError, bounds, exclusive=True
        )
        items = (raw,) if isinstance(raw, Parts | Candidate) else raw
        tests = isinstance(items, list | tuple)
        if not tests or not all(isinstance(item, Parts | Candidate) for item in items):
            raise CampaignError(
                f"at of a goal must be tests, each a Candidate, got {raw!r}: in words they are a "
                "part of the goal's text, such as 'energy at 1000 psi, 0.5 Hz, 1 in'"
            )
        object.__setattr__(self, "at", tuple(Parts(**vars(item)) for item in items))

    def places(self, typical: Sequence[Candidate]) -> list[Candidate]:
        """Motions and actuations that it is about; the typical ones where it names none.

        A motion without an actuation is one at each typical actuation.
        """
        candidates = [
            motion.completed(candidate)
            for motion in self.at
            for candidate in (typical if motion.actuation is None else typical[:1])
        ]
        return candidates or list(typical)

    @property
    def words(self) -> str:
        """What it is, in words."""
        if self.quantity in OF_LAWS:
            return f"{self.quantity} of {self.of}"
        named = {**AT_MOTIONS, "band": "band", GAP: "width of the gap"}
        return named.get(self.quantity, self.quantity)

    def unit(self, actuation_unit: str, units: Mapping[str, str]) -> str:
        """Internal unit of the quantity; `units` are those of the model's parameters."""
        if self.quantity == "slope":
            return f"{units[self.of]}/{actuation_unit}"
        return {"exponent": "1", "energy": "kip*in", GAP: "in"}.get(self.quantity, "kip")


def parse_goal(
    text: str, unit: ActuationUnit, *, of: str = "--goal", laws: Iterable[str] = ()
) -> Goal:
    """Goal of ``"energy at 1000 psi, 0.5 Hz, 1 in"``, ``"band"``, ``"exponent of Fc_fwd"``."""
    match = _FORM.fullmatch(text) if len(text) < 5000 else None
    form = (
        f"{of}: a goal reads 'energy at 1000 psi, 0.5 Hz, 1 in' or 'band' or 'exponent of Fc_fwd'"
    )
    if match is None:
        raise CampaignError(f"{form}, got {text[:80]!r}")
    name, subject = match["name"].removesuffix(" force").lower(), match["of"] or ""
    motions = tuple(parse_tests(match["at"], unit, of=of)) if match["at"] else ()
    band, law = name == "band", name in OF_LAWS
    goal = Goal(name, subject if law else "", subject if band and subject else "mean", motions)
    check_goal(goal, of=of, laws=laws)
    if subject and not law and not band:
        raise CampaignError(f"{form}: 'of {subject}' is for slope, exponent and band alone")
    return goal


def check_goal(goal: Goal, *, of: str = "--goal", laws: Iterable[str] = ()) -> None:
    """Refuse a goal that cannot be; `laws` are what follows the actuation in a user's own model."""
    quantities = (*AT_MOTIONS, GAP, *OF_LAWS)
    if goal.quantity not in quantities:
        hint = nearest(goal.quantity, quantities)
        raise CampaignError(f"{of}: unknown quantity {goal.quantity!r}; {hint}")
    if goal.kind not in KINDS:
        raise CampaignError(
            f"{of}: a band is of {' or '.join(KINDS)}, not of {goal.kind!r}: noise and offset of a "
            "record are no quantity of the population"
        )
    if goal.of and goal.quantity not in OF_LAWS:
        raise CampaignError(
            f"{of}: {goal.quantity} is not of a law, so leave out of = {goal.of!r}, which is for "
            f"{' and '.join(OF_LAWS)} alone"
        )
    laws = tuple(name for name in dict.fromkeys([*laws, *default_laws()]) if name)
    if goal.quantity in OF_LAWS and goal.of not in laws:
        raise CampaignError(
            f"{of}: {goal.quantity} needs a quantity that follows the actuation, such as "
            f"'{goal.quantity} of {laws[0]}'; they are {', '.join(laws)}; got {goal.of!r}"
        )


def check_session(session: str, sessions: Collection[str], *, of: str = "goal.session") -> None:
    """Refuse the session of a goal that no calibrated test has."""
    if not session or session in sessions:
        return
    named = [*dict.fromkeys(filter(None, sessions))]
    hint = nearest(session, named) if named else "they have no sessions"
    raise CampaignError(
        f"{of}: no calibrated test has the session {session!r}; {hint}; leave it out for a new "
        "session"
    )
