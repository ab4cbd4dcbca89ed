"""Force that the priors allow, beside the measured force."""

from __future__ import annotations

import numpy as np

from mfd_bayes.assessment.bands import fan_of
from mfd_bayes.assessment.views import Fan
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.campaign.file import Campaign
from mfd_bayes.records.trace import Trace

PRIOR_DRAWS = 400


def prior_fan(campaign: Campaign, priors: PriorFile, trace: Trace) -> Fan:
    """Bands of the force under the prior, without noise, for a test's motion."""
    posterior = Posterior(trace, priors, campaign.noise, campaign.model)
    drawn = posterior.draw_prior(np.random.default_rng(0), PRIOR_DRAWS)
    force = posterior.force(drawn) + drawn["offset"][:, None]
    return fan_of("prior", force)


def share_inside(fan: Fan, trace: Trace) -> float:
    """Share of the samples whose force is inside the widest band."""
    widest = fan.intervals[-1]
    force = np.asarray(trace.force)
    return float(np.mean((force >= widest.lower) & (force <= widest.upper)))
