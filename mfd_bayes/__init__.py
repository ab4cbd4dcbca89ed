"""Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mfd_bayes.applications.acceptance.judgement import Acceptance, accept
    from mfd_bayes.applications.buildings.building import Building, read_building
    from mfd_bayes.applications.buildings.ground import Ground, read_ground
    from mfd_bayes.applications.buildings.respond import respond
    from mfd_bayes.applications.buildings.response import Response
    from mfd_bayes.applications.export.compiled import compile_step
    from mfd_bayes.applications.next_test.next_test import next_test
    from mfd_bayes.applications.next_test.study import Advice
    from mfd_bayes.applications.properties.page import conformity_table
    from mfd_bayes.applications.reweighing.reweighing import Reweighing, reweigh
    from mfd_bayes.calibration.effort import Effort
    from mfd_bayes.calibration.posterior import Posterior
    from mfd_bayes.calibration.priors import Prior, load_priors
    from mfd_bayes.calibration.sampling import Draws, sample
    from mfd_bayes.campaign.candidate import Candidate, Goal, Limits
    from mfd_bayes.errors import MfdError
    from mfd_bayes.friction.backlash import BacklashLuGre
    from mfd_bayes.friction.bouc_wen import BoucWen
    from mfd_bayes.friction.model import Model
    from mfd_bayes.friction.quantities import Parameter
    from mfd_bayes.friction.three_stage import LuGre, ThreeStage
    from mfd_bayes.pipeline.door import calibrate, demo, inspect
    from mfd_bayes.population.bands import Band
    from mfd_bayes.population.conditioning import OnlinePredictor
    from mfd_bayes.population.population import Population
    from mfd_bayes.records.record import Record, read_record
    from mfd_bayes.records.trace import Trace
    from mfd_bayes.runs.model_average import ModelAverage
    from mfd_bayes.runs.run import Run, open_run

# Each name is imported when it is first asked for, so that `import mfd_bayes` stays quick.
_HOMES = {
    "accept": "mfd_bayes.applications.acceptance.judgement",
    "Acceptance": "mfd_bayes.applications.acceptance.judgement",
    "Advice": "mfd_bayes.applications.next_test.study",
    "BacklashLuGre": "mfd_bayes.friction.backlash",
    "Band": "mfd_bayes.population.bands",
    "BoucWen": "mfd_bayes.friction.bouc_wen",
    "Building": "mfd_bayes.applications.buildings.building",
    "calibrate": "mfd_bayes.pipeline.door",
    "Candidate": "mfd_bayes.campaign.candidate",
    "compile_step": "mfd_bayes.applications.export.compiled",
    "conformity_table": "mfd_bayes.applications.properties.page",
    "demo": "mfd_bayes.pipeline.door",
    "Draws": "mfd_bayes.calibration.sampling",
    "Effort": "mfd_bayes.calibration.effort",
    "Goal": "mfd_bayes.campaign.candidate",
    "Ground": "mfd_bayes.applications.buildings.ground",
    "inspect": "mfd_bayes.pipeline.door",
    "Limits": "mfd_bayes.campaign.candidate",
    "load_priors": "mfd_bayes.calibration.priors",
    "LuGre": "mfd_bayes.friction.three_stage",
    "MfdError": "mfd_bayes.errors",
    "Model": "mfd_bayes.friction.model",
    "ModelAverage": "mfd_bayes.runs.model_average",
    "next_test": "mfd_bayes.applications.next_test.next_test",
    "OnlinePredictor": "mfd_bayes.population.conditioning",
    "open_run": "mfd_bayes.runs.run",
    "Parameter": "mfd_bayes.friction.quantities",
    "Population": "mfd_bayes.population.population",
    "Posterior": "mfd_bayes.calibration.posterior",
    "Prior": "mfd_bayes.calibration.priors",
    "read_building": "mfd_bayes.applications.buildings.building",
    "read_ground": "mfd_bayes.applications.buildings.ground",
    "read_record": "mfd_bayes.records.record",
    "Record": "mfd_bayes.records.record",
    "respond": "mfd_bayes.applications.buildings.respond",
    "Response": "mfd_bayes.applications.buildings.response",
    "reweigh": "mfd_bayes.applications.reweighing.reweighing",
    "Reweighing": "mfd_bayes.applications.reweighing.reweighing",
    "Run": "mfd_bayes.runs.run",
    "sample": "mfd_bayes.calibration.sampling",
    "sheet_over_models": "mfd_bayes.applications.comparison.datasheets",
    "ThreeStage": "mfd_bayes.friction.three_stage",
    "Trace": "mfd_bayes.records.trace",
}

__all__ = [
    "Acceptance",
    "Advice",
    "BacklashLuGre",
    "Band",
    "BoucWen",
    "Building",
    "Candidate",
    "Draws",
    "Effort",
    "Goal",
    "Ground",
    "Limits",
    "LuGre",
    "MfdError",
    "Model",
    "ModelAverage",
    "OnlinePredictor",
    "Parameter",
    "Population",
    "Posterior",
    "Prior",
    "Record",
    "Response",
    "Reweighing",
    "Run",
    "ThreeStage",
    "Trace",
    "accept",
    "calibrate",
    "compile_step",
    "conformity_table",
    "demo",
    "inspect",
    "load_priors",
    "next_test",
    "open_run",
    "read_building",
    "read_ground",
    "read_record",
    "respond",
    "reweigh",
    "sample",
    "sheet_over_models",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # it takes as long to import as all else here

        return version("mfd_bayes")
    if name not in _HOMES:
        raise AttributeError(f"module 'mfd_bayes' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
