"""Steps of what a run is asked, which need many of its parts."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.population.bands import Band, Forecast, Predictor
from mfd_bayes.population.settings import Setting
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs import asked
from mfd_bayes.runs.following import Following
from mfd_bayes.store.cards import counted, grid

if TYPE_CHECKING:
    from mfd_bayes.runs.response import Source


class RunSteps:
    """Steps of a `Run`, which has all the attributes that they use."""

    def _repr_html_(self: Any) -> str:
        judged = self.manifest.verdicts
        rows = ((name, judged.get(name, "")) for name in self.tests)
        title = f"{self.manifest.title}: {counted(len(self.tests), 'calibrated test')}"
        sentence = asked.sentence_of(self.manifest, self.system)
        return grid(title, ("test", "may be used"), rows, sentence)

    @property
    def _some(self: Any) -> Posterior:
        """Posterior of a calibrated test: all have the same model and noise."""
        found: Posterior = next(iter(self.tests.values())).posterior
        return found

    def _predictor(self: Any) -> Predictor:
        return Predictor(self.population, self._some.model, self._some.noise)

    def _source(self: Any) -> Source:
        """The calibrated device, as the dampers of a building."""
        from mfd_bayes.runs.response import Source

        model, unit = self._some.model, self.actuation_unit
        use = asked.use_of_run(self.manifest, self.system)
        return Source(self.population, model, unit, self.tested, self.system, use)

    def _repeated(self: Any, trace: Trace, forecast: Forecast, test: str) -> Band:
        """Band of what is known of one calibrated test."""
        name = asked.this_test(self.tests, self.held_out, forecast, test)
        asked.check_level(self.tests[name], trace, self.actuation_unit, self.system)
        own = replace(forecast, session=asked.own_session(self.session(name), forecast.session))
        band: Band = self._predictor().repeat(trace, own, self.tests[name].stored.values())
        return band

    def _following(self: Any, setting: Setting) -> Following:
        """What completes the bands of a test that is followed."""
        unusable = asked.remarks_of((), self.manifest, self.system, widened=False)
        said = (*unusable, *asked.new_session(self.manifest, setting.session))
        return Following(setting, self.tested, self.system, self.actuation_unit, said, self.extras)
