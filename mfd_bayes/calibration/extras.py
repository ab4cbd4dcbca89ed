"""What results can do in a notebook, done by rooms that come later: pictures, other tools' data.

`mfd_bayes.open_run` hands an implementation to the run, and the run to what it gives out: so no
room imports from one behind it, and nothing is imported before it is asked for.
"""

from __future__ import annotations

from typing import Any, Protocol

from mfd_bayes.errors import FitError


class Extras(Protocol):
    """Pictures and ArviZ data of results."""

    def plot_band(self, band: Any, axes: Any, displacement: Any) -> Any:
        """Draw a band against time or displacement; returns Matplotlib axes."""

    def plot_loops(self, test: Any, axes: Any) -> Any:
        """Draw the loops of a calibrated test over its bands; returns Matplotlib axes."""

    def inference_data(self, result: Any) -> Any:
        """Data of a calibrated test or of a band that ArviZ's functions take."""


def needed(extras: Extras | None) -> Extras:
    """The extras of a result that came from `mfd_bayes.open_run`.

    Raises
    ------
    FitError
        When it did not.
    """
    if extras is None:
        raise FitError("this needs a result of a run that mfd_bayes.open_run has opened")
    return extras
