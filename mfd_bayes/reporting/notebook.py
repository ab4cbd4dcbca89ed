"""Results for notebooks: drawn, and handed to ArviZ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mfd_bayes.errors import ReportError, real_numbers

if TYPE_CHECKING:
    from mfd_bayes.calibration.result import TestResult
    from mfd_bayes.population.bands import Band
    from mfd_bayes.runs.unit_system import UnitSystem


@dataclass(frozen=True)
class Notebook:
    """Pictures in the units of a system, and ArviZ data, of results."""

    system: UnitSystem

    def plot_band(self, band: Band, axes: Any, displacement: Any) -> Any:
        """Axes with a band over time, or over a displacement, in."""
        from mfd_bayes.evaluation.scores import fan_of_band
        from mfd_bayes.reporting import figures

        abscissa = None
        if displacement is not None:
            abscissa = real_numbers("displacement", displacement, ReportError)
            if abscissa.shape != band.time.shape:
                raise ReportError(
                    f"displacement must have shape {band.time.shape}, a number for each sample of "
                    f"the band, got {abscissa.shape}"
                )
            if not np.all(np.isfinite(abscissa)):
                raise ReportError("displacement must be finite")
        return figures.draw_band(axes, fan_of_band(band), band.time, abscissa, self.system)

    def plot_loops(self, test: TestResult, axes: Any) -> Any:
        """Axes with the measured loops of a test over its replicated records."""
        from mfd_bayes.evaluation.scores import fan_of
        from mfd_bayes.reporting import figures
        from mfd_bayes.store.netcdf import load_groups

        force = load_groups(test.path)["posterior_predictive"]["force"].to_numpy()
        fan = fan_of("observation", force.reshape(-1, force.shape[-1]).astype(np.float64))
        trace = test.trace
        return figures.draw_band(
            axes, fan, trace.time, trace.displacement, self.system, trace.force
        )

    def to_inference_data(self, result: TestResult | Band) -> Any:
        """Groups of a test, or of a band, as ArviZ's functions take them."""
        import xarray as xr

        from mfd_bayes.calibration.cycles import density_groups
        from mfd_bayes.population.bands import Band
        from mfd_bayes.store.netcdf import arviz_data, load_groups

        if isinstance(result, Band):
            attrs = {"units": "kip", "kind": result.kind, "source": result.source}
            force = (("chain", "draw", "time"), result.draws[None], attrs)
            numbers = {"chain": [0], "draw": np.arange(len(result.draws)), "time": result.time}
            return arviz_data({"predictions": xr.Dataset({"force": force}, coords=numbers)})
        groups = load_groups(result.path)
        log_likelihood = groups["sample_stats"]["log_likelihood"].to_numpy()
        densities = density_groups(result.posterior, groups["posterior"], log_likelihood)
        return arviz_data(groups | densities)
