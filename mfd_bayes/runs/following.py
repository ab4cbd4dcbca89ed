"""What a run says of a test that is followed: where it leaves what was tested."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mfd_bayes.calibration.result import Extras
from mfd_bayes.population.bands import Band
from mfd_bayes.population.settings import Setting
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.systems import System
from mfd_bayes.runs.tested import Span, leaving, reach_of


@dataclass(frozen=True, eq=False)
class Following:
    """Completes the bands of a test under way; see `Forecaster.complete`.

    Attributes
    ----------
    planned : Setting
        The band is wider where this leaves the tested range; what the motion does is not known
        before.
    tested : tuple of Span
    system : System
    unit : {"ksi", "kip"}
        Of actuations.
    said : tuple of str
        Remarks of every band.
    extras : Extras, optional
    """

    planned: Setting
    tested: tuple[Span, ...]
    system: System
    unit: str
    said: tuple[str, ...]
    extras: Extras | None

    def __call__(self, band: Band, motion: Trace) -> Band:
        """The band with its remarks; the motion is that of the whole test, to the band's end."""
        plan = {span.name: span for span in self._plan()}
        spans = [_joined(span, plan.get(span.name, span)) for span in reach_of(motion, self.unit)]
        wider = {departure.asked.name for departure in leaving(self.tested, plan.values())}
        left = tuple(
            departure.sentence(self.system, widened=departure.asked.name in wider)
            for departure in leaving(self.tested, spans)
        )
        return replace(band, remarks=(*left, *self.said, *band.remarks), extras=self.extras)

    def _plan(self) -> tuple[Span, ...]:
        """Stroke, peak speed and actuation as they are planned."""
        level, covariates = self.planned.actuation, self.planned.covariates
        stroke, speed = 2.0 * covariates["amplitude"], covariates["velocity"]
        return (
            Span("stroke", "in", stroke, stroke),
            Span("speed", "in/s", speed, speed),
            Span("actuation", self.unit, level, level),
        )


def _joined(reached: Span, planned: Span) -> Span:
    """What a test reaches, so far or as planned: of a stroke and a speed the larger one."""
    high = max(reached.highest, planned.highest)
    low = min(reached.lowest, planned.lowest) if reached.name == "actuation" else high
    return Span(reached.name, reached.unit, low, high)
