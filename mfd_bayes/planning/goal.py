"""What is to be known better: a goal in the user's words, and its draws."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from mfd_bayes.errors import CampaignError
from mfd_bayes.planning.candidate import Candidate, Parts, parse_tests
from mfd_bayes.population.laws import default_laws
from mfd_bayes.records.inputs import real_number
from mfd_bayes.units import ActuationUnit

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
KINDS = ("device", "new_test")
_FORM = re.compile(
    r"\s*(?P<name>[A-Za-z_]+(?: force)?)(?:\s+of\s+(?P<of>\w+))?(?:\s+at\s+(?P<at>.+))?\s*",
    re.DOTALL,
)


@dataclass(frozen=True)
class Goal:
    """What is to be known better of a new device.

    Attributes
    ----------
    quantity : str
        A key of `AT_MOTIONS` or `OF_LAWS`, or "gap".
    of : str
        Quantity whose law is meant; "" for others.
    kind : {"device", "new_test"}
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
    kind: str = "device"
    at: tuple[Parts, ...] = ()
    probability: float = 0.95
    session: str = ""

    def __post_init__(self) -> None:
        for name in ("quantity", "of", "kind", "session"):
            if not isinstance(value := getattr(self, name), str):
                raise CampaignError(f"{name} of a goal must be text, got {value!r}")
        bounds, at = (0.0, 1.0), self.at
        real_number("probability of a goal", self.probability, CampaignError, bounds, inside=True)
        given = (at,) if isinstance(at, Parts | Candidate) else at
        tests = isinstance(given, list | tuple)
        if not tests or not all(isinstance(one, Parts | Candidate) for one in given):
            raise CampaignError(
                f"at of a goal must be tests, each a Candidate, got {at!r}: in words they are a "
                "part of the goal's text, such as 'energy at 1000 psi, 0.5 Hz, 1 in'"
            )
        object.__setattr__(self, "at", tuple(Parts(**vars(one)) for one in given))

    def places(self, typical: Sequence[Candidate]) -> list[Candidate]:
        """Motions and actuations that it is about; the typical ones where it names none.

        A motion without an actuation is one at each typical actuation.
        """
        found = [
            parts.completed(one)
            for parts in self.at
            for one in (typical if parts.actuation is None else typical[:1])
        ]
        return found or list(typical)

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
    name, about = match["name"].removesuffix(" force").lower(), match["of"] or ""
    at = tuple(parse_tests(match["at"], unit, of=of)) if match["at"] else ()
    band, law = name == "band", name in OF_LAWS
    goal = Goal(name, about if law else "", about if band and about else "device", at)
    check_goal(goal, of=of, laws=laws)
    if about and not law and not band:
        raise CampaignError(f"{form}: 'of {about}' is for slope, exponent and band alone")
    return goal


def check_goal(goal: Goal, *, of: str = "--goal", laws: Iterable[str] = ()) -> None:
    """Refuse a goal that cannot be; `laws` are what follows the actuation in a user's own model."""
    known = (*AT_MOTIONS, GAP, *OF_LAWS)
    if goal.quantity not in known:
        near = difflib.get_close_matches(goal.quantity, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(known)}"
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
    named = [repr(name) for name in dict.fromkeys(sessions) if name]
    near = difflib.get_close_matches(session, sessions, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    has = f"their sessions are {', '.join(named)}" if named else "they have no sessions"
    raise CampaignError(
        f"{of}: no calibrated test has the session {session!r}; {hint}{has}; leave it out for a "
        "new session"
    )
