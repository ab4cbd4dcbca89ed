"""A calibrated test, as it is stored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.stored import check_draws, check_facts
from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.records.regular import hash_file
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import StoredTest, load_test

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False)
class TestResult:
    """A calibrated test.

    Attributes
    ----------
    id : str
    posterior : Posterior
    path : Path
        Of the stored posterior.
    sha256 : str
        Of that file, where it is known: the draws of another run are not taken for this one's.
    """

    __test__ = False

    id: str
    posterior: Posterior
    path: Path
    sha256: str = ""

    @property
    def stored(self) -> StoredTest:
        """What is stored of it, read anew each time: the draws of many tests are not all held.

        Raises
        ------
        StoreError
            When the file cannot be read, or was replaced since its run was opened.
        """
        if self.sha256 and self.path.is_file() and hash_file(self.path) != self.sha256:
            raise StoreError(f"{self.path} was changed by another process since it was opened")
        return load_test(self.path)

    @property
    def draws(self) -> xr.Dataset:
        """Posterior draws as ArviZ reads them: named variables (chain, draw) with units."""
        return self.stored.draws

    @property
    def trace(self) -> Trace:
        """The record that was fitted."""
        return self.posterior.trace


def load_result(test_id: str, path: Path, priors: PriorFile) -> TestResult:
    """Calibrated test of its stored posterior.

    Raises
    ------
    StoreError
        When the file is missing, or holds no posterior under these priors.
    """
    stored = load_test(path)
    facts = stored.facts
    check_facts(facts, path)
    try:
        posterior = Posterior(
            stored.trace, priors, facts["noise"], facts["model"], start=facts["start"]
        )
    except MfdError as error:
        raise StoreError(f"{path} is damaged or not of this program: {error}") from error
    check_draws(stored, posterior, path)
    return TestResult(test_id, posterior, path)
