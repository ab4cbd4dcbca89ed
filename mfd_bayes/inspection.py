"""What a record holds, before anything is fitted to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfd_bayes.assessment.bands import fan_of
from mfd_bayes.calibration.derived import cycle_energies
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.campaign import Campaign, Test
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.views import Fan

PRIOR_DRAWS = 400


@dataclass(frozen=True)
class Inspection:
    """What was read of a file, in words, and its trace at the file's own rate."""

    name: str
    facts: dict[str, str]
    trace: Trace


def inspect_record(name: str, record: Record) -> Inspection:
    """Columns, units, rate, turning points and loops of a record."""
    trace = record.trace()
    x = trace.displacement
    columns = ", ".join(f"{role}: {n} [{unit}]" for role, (n, unit) in record.columns.items())
    facts = {
        "file": record.path.name,
        "columns": columns,
        "samples": f"{record.time.size} over {record.time[-1] - record.time[0]:.6g} s",
        "rate": f"{record.rate:.6g} Hz, jitter {record.jitter:.2%} of a step",
        "displacement": f"{x.min():.4g} to {x.max():.4g} in",
        "velocity": f"{trace.velocity.min():.4g} to {trace.velocity.max():.4g} in/s",
        "turning points": f"{trace.turning_points.size} ({trace.turning_points.size / 2:g} cycles)",
    }
    if record.actuation is not None:
        level = float(np.mean(record.actuation))
        history = " (mean of a history)" if trace.varying else ""
        facts["actuation"] = f"{level:.4g} {record.actuation_unit}{history}"
    if trace.force is not None:
        force = trace.force
        facts["force"] = f"{force.min():.4g} to {force.max():.4g} kip"
        energy = cycle_energies(force[None, :], trace)[0]
        if energy.size:
            facts["energy per full loop"] = (
                f"{np.median(energy):.4g} kip·in (median of {energy.size}, "
                f"{energy.min():.4g} to {energy.max():.4g})"
            )
    return Inspection(name, facts, trace)


def prior_fan(campaign: Campaign, priors: PriorFile, trace: Trace) -> Fan:
    """Bands of the force under the prior, without noise, for a test's motion."""
    posterior = Posterior(trace, priors, campaign.noise, campaign.model)
    drawn = posterior.draw_prior(np.random.default_rng(0), PRIOR_DRAWS)
    force = posterior.force(drawn) + drawn["offset"][:, None]
    return fan_of("prior", force)


def share_inside(fan: Fan, trace: Trace) -> float:
    """Share of the measured force inside the widest band of a fan."""
    widest = fan.intervals[-1]
    force = np.asarray(trace.force)
    return float(np.mean((force >= widest.lower) & (force <= widest.upper)))


def inspect_test(test: Test) -> Inspection:
    """What was read of one test of a campaign."""
    return inspect_record(test.id, test.read())
