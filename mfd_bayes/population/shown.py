"""What a notebook can do with a band: show it, draw it, hand it to ArviZ."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mfd_bayes.calibration.extras import needed
from mfd_bayes.population.kinds import KIND_NAMES
from mfd_bayes.store.cards import card
from mfd_bayes.units import percent


class ShownBand:
    """Methods of a `Band` for notebooks; a band has all the attributes that they use."""

    def plot(self: Any, axes: Any = None, *, displacement: ArrayLike | None = None) -> Any:
        """Matplotlib axes with the band over time, or over a displacement, (T,), in.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.
        displacement : (T,), in, optional

        Raises
        ------
        FitError
            When the band does not come from a run of `mfd_bayes.open_run`.
        """
        return needed(self.extras).plot_band(self, axes, displacement)

    def inference_data(self: Any) -> Any:
        """The draws as ArviZ takes them: group `predictions`, variable `force`, kip.

        Raises
        ------
        FitError
            When the band does not come from a run of `mfd_bayes.open_run`.
        """
        return needed(self.extras).inference_data(self)

    def _repr_html_(self: Any) -> str:
        width = float(np.mean(self.upper - self.lower))
        facts = [
            ("what", f"{KIND_NAMES[self.kind]} ({self.kind})"),
            ("probability", f"{percent(self.probability)} %, {self.interval}, of each sample"),
            ("samples", f"{self.time.size} over {np.ptp(self.time):.4g} s"),
            ("median force", f"{self.median.min():.4g} to {self.median.max():.4g} kip"),
            ("mean width", f"{width:.4g} kip"),
            ("draws", f"{len(self.draws)}, from {self.source}"),
        ]
        return card("Force band", facts, "; ".join(self.remarks))
