"""What a campaign specifies, as the manifest of its run has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, get_args

from pydantic import AfterValidator

from mfd_bayes.campaign.schema import Area, LawName, check_id
from mfd_bayes.errors import UnitError
from mfd_bayes.population.inference import InferenceSettings
from mfd_bayes.records.columns import header_unit
from mfd_bayes.store.schema import Part, Positive
from mfd_bayes.units import actuation_factor

Id = Annotated[str, AfterValidator(check_id)]
LAWS = get_args(LawName)


def _known_law(name: str) -> str:
    if name not in LAWS:
        raise ValueError(f"must be one of {', '.join(LAWS)}")
    return name


def _known_unit(unit: str) -> str:
    try:
        internal = actuation_factor(unit)
    except UnitError as error:
        raise ValueError(str(error)) from error
    if internal != (1.0, unit):
        raise ValueError("must be an internal unit of actuation, such as 'ksi' or 'kip'")
    return unit


class TestSettings(Part):
    """What a campaign says of a test; file, columns and window are stored but not used."""

    __test__ = False

    file: Any = None
    actuation: Any = None
    fit: Any = None
    session: str = ""
    after: str = ""
    """Id of the test that was made directly before it, the device not reset in between."""
    columns: Any = None

    @property
    def given_actuation(self) -> object:
        """The actuation in words, or a mapping with the "unit" of its column."""
        columns = self.columns if isinstance(self.columns, Mapping) else {}
        if self.actuation or "actuation" not in columns:
            return self.actuation
        match columns["actuation"]:
            case [column, unit, *_]:
                return {"unit": unit or header_unit(str(column))}
            case column:
                return column


class Settings(Part):
    """What a campaign specifies."""

    model: str
    noise: str
    noise_check: bool | None = None
    """Whether tests are fitted under other noises too; by default not where the effort is quick."""
    start: Any = None
    priors: str
    laws: Mapping[str, Annotated[str, AfterValidator(_known_law)]]
    dependence: Mapping[str, tuple[str, ...]] | None = None
    tolerances: Mapping[str, Positive] | None = None
    rate: Any = None
    area: Area | None = None
    actuation_unit: Annotated[str, AfterValidator(_known_unit)]
    tests: Mapping[Id, TestSettings]

    def checks_noise(self, effort: str) -> bool:
        """Whether tests are fitted under other noises too: as asked for, else unless quick."""
        return effort != "quick" if self.noise_check is None else self.noise_check

    @property
    def sessions(self) -> Mapping[str, str]:
        """Session of each test, "" where it has none."""
        return {name: test.session for name, test in self.tests.items()}

    @property
    def order(self) -> Mapping[str, str]:
        """The test that each follows without a reset, of those that follow one."""
        return {name: test.after for name, test in self.tests.items() if test.after}

    def inference(self, effort: str, seed: Sequence[int], jobs: int = 1) -> InferenceSettings:
        """Settings of the inference of the population."""
        dependence, unit = self.dependence or {}, self.actuation_unit
        return InferenceSettings(self.laws, unit, effort, seed, dependence, self.sessions, jobs)
