"""Opening a run folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.calibration.result import load_result
from mfd_bayes.errors import StoreError
from mfd_bayes.jobs.job import State
from mfd_bayes.records.regular import path_of
from mfd_bayes.runs.folder import PRIORS, check_links, check_stored, posterior_of, record_of
from mfd_bayes.runs.manifest import Manifest, read_manifest
from mfd_bayes.runs.reading import reading
from mfd_bayes.runs.run import Run
from mfd_bayes.store.netcdf import load_trace


def open_run(folder: str | Path) -> Run:
    """Finished calibration of a run folder.

    Raises
    ------
    StoreError
        When the folder is no finished run, a file in it is not what the run wrote, or another
        process changes it meanwhile.
    """
    folder = path_of("folder", folder, StoreError)
    check_links(folder)
    manifest = read_manifest(folder)
    with reading(folder, manifest):
        return _opened(folder, manifest)


def _opened(folder: Path, manifest: Manifest) -> Run:
    digests = manifest.files or {}
    priors = load_priors(check_stored(folder, PRIORS, digests).name, folder)
    tests, held_out = {}, {}
    for test_id, entry in manifest.tests.items():
        if entry.role == "validate":
            path = check_stored(folder, record_of(test_id), digests)
            held_out[test_id] = load_trace(path)[0]
        elif entry.status == State.DONE:
            name = posterior_of(test_id)
            found = load_result(test_id, check_stored(folder, name, digests), priors)
            tests[test_id] = replace(found, sha256=digests.get(name, ""))
    if not tests:
        raise StoreError(f"the run in {folder} has no calibrated test")
    return Run(folder, manifest, priors, tests, held_out)
