"""A campaign: its file, read and checked, and its tests."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from pydantic import ValidationError

from mfd_bayes.campaign.candidate import (
    Goal,
    Limits,
    Parts,
    check_goal,
    check_session,
    parse_limits,
    parse_tests,
)
from mfd_bayes.campaign.schema import (
    TABLES,
    CampaignFile,
    Column,
    DesignTable,
    General,
    GoalTable,
    Instrument,
    NoiseName,
    Role,
    TestTable,
    keys_of,
)
from mfd_bayes.campaign.standard import Standard, read_standard
from mfd_bayes.errors import CampaignError, UnitError, file_inside
from mfd_bayes.friction import models
from mfd_bayes.friction.model import Model
from mfd_bayes.population.design import CONDITIONS, complete_laws, default_laws
from mfd_bayes.records.cycles import quantities
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import NO_ACTUATION, Record, Source, Window, parse_window, read_record
from mfd_bayes.records.table import header_unit
from mfd_bayes.store.files import TomlError, faults_text, nearest, read_toml
from mfd_bayes.units import (
    ActuationUnit,
    Axes,
    actuation_factor,
    actuation_kind,
    measure,
    parse_actuation,
)


@dataclass(frozen=True, eq=False)
class Test:
    """One test of a campaign."""

    __test__: ClassVar[bool] = False  # pytest must not take it for a test class

    id: str  # the name of its folder; no two differ only in the case of their letters
    path: Path  # inside the campaign's folder, links resolved
    actuation: str | None  # constant; None where `columns` has the role "actuation"
    window: Window | None  # the part of the record that is fitted, s
    role: Role
    columns: dict[str, Source]  # by role, of those that the campaign file gives
    session: str
    after: str
    axes: Axes

    def read(self) -> Record:
        """Record of this test; raises as `read_record` does."""
        return read_record(
            self.path, self.columns, None, self.actuation, window=self.window, axes=self.axes
        )


@dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign file, checked."""

    path: Path
    folder: Path  # of the file, links resolved; all test files are inside it
    settings: CampaignFile  # with its defaults, and the unit of each measured actuation
    tests: tuple[Test, ...]
    force_model: Model  # that `settings` names
    standard: Standard | None = None  # that `settings.design` names
    replaced: bool = False  # whether it is not the file's own: its priors may have those of others

    @property
    def title(self) -> str:
        """The campaign file's name where no title is given."""
        return self.settings.campaign.title or self.path.stem

    @property
    def priors(self) -> str:
        """A name, or a path relative to `folder`."""
        return self.settings.campaign.priors

    @property
    def model(self) -> str:
        """Name of the friction model."""
        return self.settings.model

    @property
    def model_file(self) -> Path | None:
        """File of a model of the user's own, inside `folder`; None of any other model."""
        file = models.file_of(self.model)
        return self.folder / file if file else None

    @property
    def axes(self) -> Axes:
        """What the model's motion and response are; whether its tests have time and actuation."""
        actuated = any(test.actuation is not None for test in self.settings.test)
        return replace(self.force_model.axes, actuated=actuated)

    @property
    def noise(self) -> str:
        """Name of the noise."""
        return self.settings.noise

    @property
    def rate(self) -> float | None:
        """Rate to which records are thinned, Hz."""
        return self.settings.campaign.rate

    def since(self, test: Test) -> float:
        """Time in a test's file at which the test before it ended, s, if it is in the same file."""
        earlier = (t for t in self.tests if t.id == test.after and t.path == test.path)
        return max((t.window[1] for t in earlier if t.window), default=-math.inf)


def load_campaign(
    path: str | Path, model: str | None = None, noise: NoiseName | None = None
) -> Campaign:
    """Campaign of a TOML file; test files must exist but are not read yet.

    `model` and `noise` stand in place of the file's own. The file of a user's own model is run, if
    it is in the campaign's folder. A test file is read where only its row of units tells the unit
    of its actuation.
    """
    path = Path(path)
    content = _read_toml(path)
    try:
        folder = path.resolve().parent
    except (OSError, RuntimeError) as error:
        raise CampaignError(f"cannot read {path}: {error}") from error
    general = content.get("campaign")
    file_model = general.get("model") if isinstance(general, dict) else None
    if not (
        isinstance(file_model, str)
        and (file_model in models.model_names() or models.file_of(file_model))
    ):
        file_model = General().model  # what is wrong with it is said with the other faults
    force_model = models.find_model(model or file_model, folder)
    axes, replaced = force_model.axes, model not in (None, "", file_model)
    if not axes.timed and isinstance(general, dict) and "rate" in general:
        raise CampaignError(
            f"campaign.rate in {path}: samples are numbered for a rate-independent model; leave "
            "rate out"
        )
    settings = _checked(path, content, axes)
    if not replaced:
        _check_own_names(path, settings, force_model)
    overrides = {"model": model or settings.model, "noise": noise or settings.noise}
    table, laws = settings.campaign.model_copy(update=overrides), _laws_of(settings, force_model)
    settings = settings.model_copy(update={"campaign": table, "laws": laws})
    tests = []
    for entry in settings.test:
        if entry.rate is not None and "time" in entry.columns.given:
            raise CampaignError(
                f"test {entry.id!r} in {path}: a time is given either by its column or by a rate"
            )
        file, level = _find_file(path, folder, entry), entry.actuation or NO_ACTUATION
        if isinstance(level, Column):
            unit = _history_unit(path, entry.id, level, file)
            level = level.model_copy(update={"unit": unit})
            settings = settings.with_test(entry.id, actuation=level)
            entry = settings.tests[entry.id]
        window = None
        if entry.window is not None:
            try:
                of = f"window of test {entry.id!r} in {path}"
                window = parse_window(entry.window, of=of, timed=axes.timed)
            except UnitError as error:
                raise CampaignError(str(error)) from error
        tests.append(
            Test(
                entry.id,
                file,
                None if isinstance(level, Column) else level,
                window,
                entry.role,
                {role: column.source for role, column in settings.columns_of(entry).items()},
                entry.session,
                entry.after,
                axes,
            )
        )
    _check_tests(path, settings, force_model)
    _check_order(path, tests)
    _check_instruments(path, settings)
    names = [*force_model.laws, *([settings.goal.of] if settings.goal and replaced else [])]
    goal = goal_settings(settings.goal, settings.actuation_unit, path, names).goal
    learned = [test.session for test in tests if test.role == "calibrate"]
    check_session(goal.session, learned, of=f"goal.session in {path}")
    standard = None
    if settings.design is not None:
        standard = _standard_of(path, folder, settings, settings.design, axes)
    return Campaign(path, folder, settings, tuple(tests), force_model, standard, replaced)


def _standard_of(
    path: Path, folder: Path, settings: CampaignFile, design: DesignTable, axes: Axes
) -> Standard:
    """The standard of a campaign; refuses a design of no damper, or without an actuation."""
    if not (axes.of_damper and axes.timed):
        raise CampaignError(
            f"[design] in {path} is for dampers in time; the response of {settings.model} is "
            f"{axes.response.name}: leave it out"
        )
    levels = {test.actuation for test in settings.test}
    if design.target and design.actuation is None and len(levels) > 1:
        raise CampaignError(
            f"design.actuation is missing in {path}: {len(levels)} actuations were tested, at "
            "which do the targets hold?"
        )
    if design.actuation and parse_actuation(design.actuation)[1] != settings.actuation_unit:
        raise CampaignError(
            f"design.actuation in {path} must be {actuation_kind(settings.actuation_unit)}, as in "
            f"the tests, got {design.actuation!r}"
        )
    return read_standard(design.standard, folder, f"design.standard in {path}")


def _check_own_names(path: Path, settings: CampaignFile, model: Model) -> None:
    """Refuse laws and dependences of what a model of the user's own does not have."""
    if settings.model in models.MODELS:
        return
    for table, allowed in (("laws", model.laws), ("dependence", model.parameters)):
        for name in getattr(settings, table):
            if name not in allowed:
                hint = nearest(name, tuple(allowed)) if allowed else "it has none"
                raise CampaignError(
                    f"unknown key {name!r} in [{table}] of {path}, by {model.where}; {hint}"
                )


def _laws_of(settings: CampaignFile, model: Model) -> dict[str, str]:
    """Law of each quantity that follows the actuation, as the model that is used has them."""
    if model.name not in models.MODELS:
        return {name: settings.laws.get(name, law) for name, law in model.laws.items()}
    # if the file's own model is one of the user's, so are its laws
    laws = complete_laws(settings.laws if settings.model in models.MODELS else {})
    return {name: laws[name] for name in default_laws()}


def _find_file(path: Path, folder: Path, entry: TestTable) -> Path:
    """Path of a test's file, which must be in the campaign's folder once links are followed."""
    subject = f"file {entry.file!r} of test {entry.id!r} in {path}"
    try:
        file = file_inside(folder, entry.file)
        if file is None:
            raise CampaignError(f"{subject} lies outside the campaign's folder")
        if not file.is_file():
            is_windows = re.search(r"[\\\x00-\x1f]", entry.file)
            hint = "; write / in place of \\" if is_windows else ""
            raise CampaignError(f"{subject} does not exist{hint}")
    except (OSError, RuntimeError, ValueError) as error:
        raise CampaignError(f"{subject} cannot be found: {error}") from error
    return file


def _history_unit(path: Path, test: str, column: Column, file: Path) -> str:
    """Unit of a measured actuation: as given, or of its name, or of the file's row of units."""
    unit = column.unit or header_unit(column.name or "")
    if column.unit is None and not (unit and measure(unit) != "ratio" and _is_actuation(unit)):
        table = read_table(file)
        name = table.name_of(column.key)
        unit = table.units.get(name, unit or header_unit(name))
    subject = f"actuation of test {test!r} in {path}"
    if unit is None:
        key = f"name = {column.name!r}" if column.name else f"column = {column.column}"
        raise CampaignError(f"{subject} needs a unit: {{ {key}, unit = … }}")
    try:
        actuation_factor(unit, of=f"the {subject}")
    except UnitError as error:
        raise CampaignError(str(error)) from error
    return unit


def _is_actuation(unit: str) -> bool:
    """Whether a unit is one of an actuation; "force" of "axial_force" is none."""
    try:
        actuation_factor(unit)
    except UnitError:
        return False
    return True


def _check_tests(path: Path, settings: CampaignFile, model: Model) -> None:
    """Refuse actuations that lack or are of several kinds, equal ids, and nothing to calibrate."""
    if unactuated := [test.id for test in settings.test if test.actuation is None]:
        message = f"test {unactuated[0]!r}.actuation is missing in {path}"
        if not model.source:
            raise CampaignError(message)
        if model.laws:
            raise CampaignError(f"{message}: {' and '.join(model.laws)} of {model.where} follow it")
        if len(unactuated) < len(settings.test):
            raise CampaignError(f"{message}: expected one in all tests or in none")
    ids: dict[str, str] = {}
    kinds: dict[ActuationUnit, str] = {}
    for test in settings.test:
        if (twin := ids.get(test.id.lower())) is not None:
            hint = "" if twin == test.id else f" (as {twin!r}; case does not tell folders apart)"
            raise CampaignError(f"two tests of {path} have the id {test.id!r}{hint}")
        ids[test.id.lower()] = test.id
        kinds.setdefault(actuation_factor(test.actuation_unit)[1], test.id)
    if len(kinds) > 1:
        texts = (f"that of test {name!r} is {actuation_kind(u)}" for u, name in kinds.items())
        raise CampaignError(
            f"actuations of {path} must be all of one kind, as all pressures or all forces; "
            + ", ".join(texts)
        )
    for name, conditions in settings.dependence.items():
        for test in settings.test:
            for condition in conditions:
                if condition in CONDITIONS and condition not in test.conditions:
                    raise CampaignError(
                        f"dependence.{name} in {path}: it is to follow the {condition}, and test "
                        f"{test.id!r} has no {condition}"
                    )
    if all(test.role == "validate" for test in settings.test):
        raise CampaignError(f"{path} has no test with role 'calibrate'")
    if settings.area is not None and "ksi" not in kinds:
        ((unit, name),) = kinds.items()
        raise CampaignError(
            f"area in [campaign] of {path} is for actuations that are pressures; the actuation of "
            f"test {name!r} is {actuation_kind(unit)}: leave area out"
        )


def _check_order(path: Path, tests: Sequence[Test]) -> None:
    """Refuse tests that follow each other as they cannot have been made."""
    by_id = {test.id: test for test in tests}
    follower: dict[str, str] = {}
    for test in tests:
        if not test.after:
            continue
        field = f"after of test {test.id!r} in {path}"
        if test.after not in by_id:
            raise CampaignError(
                f"{field} must be the id of another test, got {test.after!r}; "
                f"{nearest(test.after, by_id)}"
            )
        rival = follower.setdefault(test.after, test.id)
        if rival != test.id:
            raise CampaignError(
                f"{field} must be a test that no other follows directly, got {test.after!r}, which "
                f"test {rival!r} follows"
            )
    for test in tests:
        chain = [test.id, test.after]
        while chain[-1] and chain[-1] not in chain[:-1]:
            chain.append(by_id[chain[-1]].after)
        if chain[-1]:
            raise CampaignError(
                f"after of test {test.id!r} in {path} must lead back to a test that follows none, "
                f"got a circle: {' after '.join(chain)}"
            )
        previous = by_id.get(test.after)
        if previous is None or previous.path != test.path:
            continue
        if not (test.window and previous.window and test.window[0] >= previous.window[1]):
            raise CampaignError(
                f"after of test {test.id!r} in {path} is a test of the same file, {previous.id!r}: "
                "the window of the one must begin where that of the other ends, or later, got "
                f"{_window_text(test.window)} after {_window_text(previous.window)}"
            )


def _check_instruments(path: Path, settings: CampaignFile) -> None:
    """Refuse two uncertainties of one instrument, or of one arm."""
    stated: dict[Instrument, tuple[str, float]] = {}
    for test, instrument, uncertainty in settings.stated_uncertainties():
        other_test, other_value = stated.setdefault(instrument, (test, uncertainty))
        if uncertainty != other_value:
            role, name = instrument
            key, hint = "uncertainty", "; or name two instruments by the key instrument"
            words = f"instrument {name!r} of the {role}"
            if role == "arm":
                key, words, hint = "arm_uncertainty", f"arm, {name!r}", ""
            raise CampaignError(
                f"{key} of test {test!r} in {path} must be {other_value:g}, that of test "
                f"{other_test!r}, which has the same {words}, got "
                f"{uncertainty:g}{hint}"
            )


def _window_text(window: Window | None) -> str:
    return "all of the file" if window is None else f"{window[0]:g} s to {window[1]:g} s"


class GoalSettings(NamedTuple):
    """What is to be known better, and by which tests: none for a grid of the campaign's range."""

    goal: Goal = Goal()
    candidates: Sequence[Parts] = ()
    limits: Limits = Limits()  # of the actuator


def goal_settings(
    table: GoalTable | None, unit: ActuationUnit, path: Path, laws: Sequence[str]
) -> GoalSettings:
    """What the table `[goal]` of a campaign file says; the default without one.

    What follows the actuation in a user's own model is in `laws`.
    """
    if table is None:
        return GoalSettings()

    def tests(key: str, texts: tuple[str, ...]) -> tuple[Parts, ...]:
        return tuple(parse_tests(texts, unit, of=f"goal.{key} in {path}")) if texts else ()

    motions = tests("at", table.at)
    goal = Goal(table.quantity, table.of, table.kind, motions, table.probability, table.session)
    check_goal(goal, of=f"goal.quantity in {path}", laws=laws)
    limits = parse_limits(table.limits, of=f"goal.limits in {path}") if table.limits else Limits()
    return GoalSettings(goal, tests("candidates", table.candidates), limits)


def _checked(path: Path, content: dict[str, Any], axes: Axes) -> CampaignFile:
    """The content of a file, checked, with columns called as in the package."""
    content = _in_roles(path, content, axes)
    try:
        return CampaignFile.model_validate(content)
    except ValidationError as error:
        raise CampaignError(faults_text(path, content, error, _keys, axes.name)) from None


def _keys(tables: list[str]) -> Collection[str]:
    """Keys that a table may have."""
    table = tables[-1] if tables else ""
    if table == "target":
        return quantities()
    return keys_of(table if table in TABLES or len(tables) == 1 else "actuation")


def _in_roles(path: Path, content: dict[str, Any], axes: Axes) -> dict[str, Any]:
    """The content with the package's names of columns in place of a model's own."""

    def renamed(table: Any) -> Any:
        columns = table.get("columns") if isinstance(table, dict) else None
        if axes.of_damper or not isinstance(columns, dict):
            return table
        allowed = tuple(map(axes.name, ("time", "displacement", "force")))
        for key in columns:
            if axes.name(key) != key:
                raise CampaignError(
                    f"unknown key {key!r} in columns of {path}, by its model; expected "
                    f"{', '.join(allowed)}"
                )
        return {**table, "columns": {axes.role(key): value for key, value in columns.items()}}

    tests = content.get("test")
    named = {"test": [renamed(test) for test in tests]} if isinstance(tests, list) else {}
    return {**renamed(content), **named}


def _read_toml(path: Path) -> dict[str, Any]:
    if path.is_dir():
        example = path / "campaign.toml"
        raise CampaignError(f"{path} is a folder: give the campaign file in it, {example}")
    try:
        return read_toml(path)
    except OSError as error:
        files = [] if path.exists() else [file.name for file in path.parent.glob("*.toml")]
        matches = difflib.get_close_matches(path.name, files, n=1)
        hint = f"; did you mean {matches[0]!r}?" if matches else ""
        reason = error.strerror or str(error)
        if not path.parent.is_dir():
            reason = f"there is no folder {path.parent}"
        raise CampaignError(f"cannot read {path}: {reason}{hint}") from error
    except TomlError as error:
        raise CampaignError(f"{path} {error}") from error
