"""Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mfd_bayes.applications.acceptance.judgement import Acceptance, accept
    from mfd_bayes.applications.buildings.respond import respond
    from mfd_bayes.applications.next_test.next_test import next_test
    from mfd_bayes.applications.next_test.study import Advice
    from mfd_bayes.calibration.posterior import Posterior
    from mfd_bayes.calibration.sampling import Draws, sample
    from mfd_bayes.campaign.candidate import Candidate, Goal, Limits
    from mfd_bayes.errors import MfdError
    from mfd_bayes.friction.backlash import BacklashLuGre
    from mfd_bayes.friction.bouc_wen import BoucWen
    from mfd_bayes.friction.model import Model
    from mfd_bayes.friction.quantities import Parameter
    from mfd_bayes.friction.three_stage import LuGre, ThreeStage
    from mfd_bayes.population.bands import Band
    from mfd_bayes.population.conditioning import OnlinePredictor
    from mfd_bayes.records.record import Record, read_record
    from mfd_bayes.records.trace import Trace
    from mfd_bayes.runs.model_average import ModelAverage
    from mfd_bayes.runs.run import Run, open_run

# Each name is imported when it is first asked for, so that `import mfd_bayes` stays quick.
_HOMES = {
    "Acceptance": "mfd_bayes.applications.acceptance.judgement",
    "Advice": "mfd_bayes.applications.next_test.study",
    "Band": "mfd_bayes.population.bands",
    "BacklashLuGre": "mfd_bayes.friction.backlash",
    "BoucWen": "mfd_bayes.friction.bouc_wen",
    "Candidate": "mfd_bayes.campaign.candidate",
    "Draws": "mfd_bayes.calibration.sampling",
    "Goal": "mfd_bayes.campaign.candidate",
    "Limits": "mfd_bayes.campaign.candidate",
    "OnlinePredictor": "mfd_bayes.population.conditioning",
    "LuGre": "mfd_bayes.friction.three_stage",
    "MfdError": "mfd_bayes.errors",
    "Model": "mfd_bayes.friction.model",
    "Parameter": "mfd_bayes.friction.quantities",
    "ModelAverage": "mfd_bayes.runs.model_average",
    "Posterior": "mfd_bayes.calibration.posterior",
    "Record": "mfd_bayes.records.record",
    "Run": "mfd_bayes.runs.run",
    "ThreeStage": "mfd_bayes.friction.three_stage",
    "Trace": "mfd_bayes.records.trace",
    "accept": "mfd_bayes.applications.acceptance.judgement",
    "next_test": "mfd_bayes.applications.next_test.next_test",
    "open_run": "mfd_bayes.runs.run",
    "read_record": "mfd_bayes.records.record",
    "respond": "mfd_bayes.applications.buildings.respond",
    "sample": "mfd_bayes.calibration.sampling",
}

__all__ = [
    "Acceptance",
    "Advice",
    "BacklashLuGre",
    "Band",
    "BoucWen",
    "Candidate",
    "Draws",
    "Goal",
    "Limits",
    "LuGre",
    "MfdError",
    "Model",
    "ModelAverage",
    "OnlinePredictor",
    "Parameter",
    "Posterior",
    "Record",
    "Run",
    "ThreeStage",
    "Trace",
    "accept",
    "next_test",
    "open_run",
    "read_record",
    "respond",
    "sample",
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
