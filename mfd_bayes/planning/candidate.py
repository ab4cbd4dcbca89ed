"""Tests that could be made: what each is, what it costs, and what an actuator allows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from mfd_bayes.errors import CampaignError, UnitError
from mfd_bayes.records.harmonic import MOST_CYCLES
from mfd_bayes.records.numbers import real_number
from mfd_bayes.units import (
    ActuationUnit,
    actuation_kind,
    measure,
    parse_actuation,
    parse_quantity,
)

SETUP = 0.25
"""Time on the frame beside the motion itself, h: setting the actuation, a check of the record."""

WAVEFORMS = ("sine", "triangle")

MOST = 1000
"""Most candidates of one question."""

FORM = "a test reads '1000 psi, 0.5 Hz, 1 in, 3 cycles'"

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.ASCII)
_ALTERNATIVES = re.compile(r"\s*([^a-zA-Zµμ%°]*\|[^a-zA-Zµμ%°]*)(.*)", re.ASCII)
_LONGEST = 20_000


_RANGES = {
    "actuation": (0.0, np.inf),
    "frequency": (0.0, np.inf),
    "amplitude": (0.0, np.inf),
    "cycles": (1.0, float(MOST_CYCLES)),
    "price": (0.0, np.inf),
}
_ABOVE = ("frequency", "amplitude")


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
    """

    actuation: float
    frequency: float
    amplitude: float
    cycles: float = 3.0
    waveform: str = "sine"
    price: float | None = None

    def __post_init__(self) -> None:
        """Refuse what is no test.

        Raises
        ------
        CampaignError
            When a number is none or out of its range, or the waveform is unknown.
        """
        for name, bounds in _RANGES.items():
            value, what = getattr(self, name), f"{name} of a test"
            if name != "price" or value is not None:
                number = real_number(what, value, CampaignError, bounds, inside=name in _ABOVE)
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
        around = 4.0 if self.waveform == "triangle" else 6.283185307179586
        return around * self.frequency * self.amplitude


@dataclass(frozen=True)
class Limits:
    """What the actuator of the frame can do; None where there is no limit.

    Attributes
    ----------
    velocity : float, in/s
    stroke : float, in
        From one end of the motion to the other.
    force : float, kip
    """

    velocity: float | None = None
    stroke: float | None = None
    force: float | None = None

    def __post_init__(self) -> None:
        """Refuse what is no limit, by a CampaignError."""
        for name, value in dict(vars(self)).items():
            if value is not None:
                what, above = f"limit of the {name}", (0.0, np.inf)
                number = real_number(what, value, CampaignError, above, inside=True)
                object.__setattr__(self, name, number)

    def allow(self, candidate: Candidate) -> bool:
        """Whether its motion is within the limits; its force is known only once simulated.

        Raises
        ------
        CampaignError
            When it is no candidate.
        """
        if not isinstance(candidate, Candidate):
            raise CampaignError(f"candidate must be a Candidate, got {candidate!r}")
        fast = self.velocity is not None and candidate.speed > self.velocity * (1 + 1e-9)
        long = self.stroke is not None and candidate.stroke > self.stroke * (1 + 1e-9)
        return not (fast or long)


def parse_limits(text: str, *, of: str = "--limits") -> Limits:
    """Limits of ``"10 in/s, 6 in, 20 kip"``: velocity, stroke and force, in any order.

    Raises
    ------
    CampaignError
        When a part is none of these, stands there twice, or is not above zero.
    """
    found: dict[str, float] = {}
    form = f"{of}: limits read '10 in/s, 6 in, 20 kip' (velocity, stroke, force)"
    named = {"velocity": ("velocity", "velocity"), "length": ("stroke", "displacement")}
    for part in text.split(","):
        name, dimension = named.get(_measured(part) or "", ("force", "force"))
        try:
            value = parse_quantity(part, dimension)
        except UnitError as error:
            raise CampaignError(f"{form}, got {text!r}: {error}") from error
        if name in found or not value > 0.0:
            why = "is there twice" if name in found else "must be above zero"
            raise CampaignError(f"{form}, got {text!r}: the {name} {why}")
        found[name] = value
    return Limits(**found)


@dataclass(frozen=True)
class Parts:
    """Parts of a test that a text gives; None where it is silent."""

    actuation: float | None = None
    frequency: float | None = None
    amplitude: float | None = None
    cycles: float | None = None
    waveform: str | None = None
    price: float | None = None

    def completed(self, typical: Candidate) -> Candidate:
        """The test, with the parts of a typical one where it has none."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        rest = {name: value for name, value in vars(typical).items() if name != "price"}
        return Candidate(**(rest | given))


def parse_tests(
    text: str | Sequence[str], unit: ActuationUnit, *, of: str = "--candidates"
) -> list[Parts]:
    """Tests of ``"500|1000 psi, 0.5 Hz, 1 in; 1350 psi, 0.1 Hz, 1 in, triangle, 2 h"``.

    Semicolons, or the items of a list, are between tests; a part with bars gives a test for each
    of its values. The parts are told apart by their units: actuation, frequency, amplitude (half
    the stroke), cycles, waveform, and the cost as a time.

    Parameters
    ----------
    text : str or sequence of str
    unit : {"ksi", "kip"}
        Of the campaign's actuation.
    of : str
        What has the text, for messages.

    Raises
    ------
    CampaignError
        When a part is not understood, or there are too many tests.
    """
    if not isinstance(text, str) and not all(isinstance(part, str) for part in text):
        raise CampaignError(f"{of}: {FORM}, got {text!r}")
    whole = text if isinstance(text, str) else ";".join(text)
    if len(whole) > _LONGEST:
        raise CampaignError(f"{of}: longer than {_LONGEST} characters")
    found: list[Parts] = []
    for one in filter(str.strip, whole.split(";")):
        for parts in _combinations(one, of):
            found.append(_parts(parts, unit, of))
            if len(found) > MOST:
                raise CampaignError(f"{of}: more than {MOST} tests, the most of one question")
    if not found:
        raise CampaignError(f"{of}: {FORM}, got {whole[:80]!r}")
    return found


def _combinations(text: str, of: str) -> Iterator[tuple[str, ...]]:
    """Parts of a test, for each combination of the values that have bars between them."""
    choices: list[list[str]] = []
    for part in text.split(","):
        if "|" in part and (match := _ALTERNATIVES.fullmatch(part)):
            choices.append([f"{value.strip()} {match[2]}" for value in match[1].split("|")])
        elif "|" in part:
            choices.append([value.strip() for value in part.split("|")])
        else:
            choices.append([part.strip()])
    return product(*choices)


def _parts(texts: Sequence[str], unit: ActuationUnit, of: str) -> Parts:
    found: dict[str, float | str] = {}
    for text in texts:
        try:
            name, value = _part(text, unit)
        except UnitError as error:
            raise CampaignError(f"{of}: {FORM}, got {', '.join(texts)!r}: {error}") from error
        if name in found:
            raise CampaignError(f"{of}: {FORM}, got two values of the {name}: {', '.join(texts)!r}")
        found[name] = value
    return Parts(**found)  # type: ignore[arg-type]


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
        return "cycles", _cycles(float(match[1]), text)
    named = {"length": ("amplitude", "displacement"), "time": ("price", "time")}
    measured = _measured(text)
    if measured not in ("length", "time", "rate", None):
        level, own = parse_actuation(text)
        if own != unit:
            raise UnitError(f"the campaign's actuation is {actuation_kind(unit)}, {text!r} is not")
        return "actuation", level
    name, dimension = named.get(measured or "", ("frequency", "rate"))
    value = parse_quantity(text, dimension)
    if not 0.0 < value < 1e9:
        raise UnitError(f"{text!r} must be above zero, and not too large")
    return name, value / 3600.0 if name == "price" else value


def _cycles(cycles: float, text: str) -> float:
    if not 1.0 <= cycles <= MOST_CYCLES:
        raise UnitError(f"a test has 1 to {MOST_CYCLES} cycles, not {text!r}")
    return cycles


def _measured(text: str) -> str | None:
    """What the unit of a text measures; None where it has none that is known."""
    match = _NUMBER.fullmatch(text)
    return measure(match[2]) if match else None
