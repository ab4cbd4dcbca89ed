"""Force that the priors allow, beside the measured force, and the prior that fits it least."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import PriorFile
from mfd_bayes.campaign.campaign import Campaign
from mfd_bayes.evaluation.scores import fan_of
from mfd_bayes.evaluation.views import Fan
from mfd_bayes.friction.model import Model
from mfd_bayes.records.loops import Scales, scales_of
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.unit_system import System

PRIOR_DRAWS = 400

MOST = 0.5
"""Share of a test's force inside the 95 % prior band below which its priors are wrong."""


@dataclass(frozen=True)
class Misfit:
    """A prior's median, `expected`, and what a record shows, `observed`, in `unit`.

    `away` is their distance in standard deviations of the prior, `source` where the figure is read.
    """

    quantity: str
    unit: str
    expected: float
    observed: float
    away: float
    source: str

    def sentence(self, system: System) -> str:
        """What is wrong with the prior, and what would mend it."""
        value = system.words([self.observed], self.unit, 3)
        return (
            f"the prior most wrong is that of {self.quantity}: its median is "
            f"{system.words([self.expected], self.unit, 3)}, and {self.source} is {value}, "
            f"{self.away:.2g} of its standard deviations away; give it a median of about {value}, "
            "or let mfd-bayes init write priors.toml from the records"
        )


def prior_fan(campaign: Campaign, priors: PriorFile, trace: Trace) -> Fan:
    """Bands of the force under the prior, without noise, for a test's motion."""
    posterior = Posterior(trace, priors, campaign.noise, campaign.force_model)
    drawn = posterior.draw_prior(np.random.default_rng(0), PRIOR_DRAWS)
    return fan_of("prior", posterior.force(drawn) + drawn["offset"][:, None])


def share_inside(fan: Fan, trace: Trace) -> float:
    """Share of the samples whose force is inside the widest band."""
    force, widest = np.asarray(trace.force), fan.widest
    return float(np.mean((force >= widest.lower) & (force <= widest.upper)))


def most_wrong(priors: PriorFile, model: Model, traces: Sequence[Trace]) -> Misfit | None:
    """The prior of a model that is farthest from what records show, by its own spread.

    None where the records show no scales, or no prior can be compared with one.
    """
    scales = [own for trace in traces if (own := scales_of(trace)) is not None]
    misfits = (misfit for own in scales for misfit in _misfits(priors, own, model.standard_names))
    return max(misfits, key=lambda misfit: misfit.away, default=None)


def _misfits(priors: PriorFile, scales: Scales, names: frozenset[str]) -> Iterator[Misfit]:
    """Each prior that a record shows something of, beside it."""
    slip = ("kip", scales.force, "the plateau of the loop")
    rise = ("kip/in", scales.build_up, "the slope at which the force comes back")
    shown = {
        **dict.fromkeys(("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd"), slip),
        "sigma0": ("kip/in", scales.unloading, "the slope after a reversal"),
        **dict.fromkeys(("k3", "k", "k_fwd", "k_bwd"), rise),
        "d2": ("in", 0.5 * scales.length, "half the travel until the force has come back"),
    }
    for name, (unit, value, source) in shown.items():
        prior = priors.parameters.get(name)
        if prior is None or name not in names:
            continue
        drawn = prior.draw(np.random.default_rng(0), 1001)
        middle, at = prior.typical, value
        if prior.on_half_line:
            drawn, middle = np.log(drawn), float(np.log(middle))
            at = float(np.log(value)) if value > 0.0 else np.nan
        spread = float(np.std(drawn))
        if spread > 0.0 and np.isfinite(at):
            yield Misfit(name, unit, prior.typical, value, abs(at - middle) / spread, source)
