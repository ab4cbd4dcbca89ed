"""Do the statistical tests hold for other seeds, and on processors without AVX-512 or AVX2?

    nice python -m benchmarks.seeds.run 20 > benchmarks/seeds/seeds.txt

runs TESTS with the seeds 1 to 20 on each of three sets of instructions: two minutes for each seed
on a quiet core (--slow: the slow ones too, an hour for each; --quick: one file with one seed). Each
`default_rng(seed)` of tests and package becomes `default_rng([seed, number])`: what is the same for
one seed stays the same. Processes that a test starts keep their own seeds. A failure is a tolerance
that is too narrow, or a fault that the tests' own seeds hide. Exit status 1: a test failed.
"""

import os
import re
import subprocess
import sys
import time

import numpy as np

from benchmarks import common

SETS = {
    "all": {},
    "no AVX-512": {"NPY_DISABLE_CPU_FEATURES": "X86_V4", "OPENBLAS_CORETYPE": "Haswell"},
    "no AVX2": {"NPY_DISABLE_CPU_FEATURES": "X86_V4 X86_V3", "OPENBLAS_CORETYPE": "Nehalem"},
}
TESTS = (
    *("tests/statistical", "tests/planning", "tests/population/test_exact.py"),
    *("tests/population/test_mixed_model.py", "tests/population/test_predict.py"),
    *("tests/population/test_given.py", "tests/calibration/test_sampling.py"),
    "tests/calibration/test_diagnostics.py",
)


def pytest_configure(config):
    """As a plugin of pytest: draw other random numbers from every seed."""
    default_rng, number = np.random.default_rng, int(os.environ["BENCHMARK_SEED"])

    def other(seed=None):
        if isinstance(seed, int | np.integer | list | tuple | np.ndarray):
            seed = [*np.atleast_1d(np.asarray(seed, dtype=object)).ravel().tolist(), number]
        elif isinstance(seed, np.random.SeedSequence):
            words = [*np.atleast_1d(seed.entropy).tolist(), number]
            seed = np.random.SeedSequence(words, spawn_key=seed.spawn_key)
        return default_rng(seed)

    np.random.default_rng = other


def main():
    parser = common.parser_of(__doc__)
    parser.add_argument("seeds", type=int, nargs="?", default=20)
    parser.add_argument("tests", nargs="*", default=TESTS)
    parser.add_argument("--slow", action="store_true", help="the slow tests too")
    options = common.begin(parser)
    seeds = 1 if options.quick else options.seeds
    tests = TESTS[7:8] if options.quick else options.tests
    print(f"{'':14}{'seed':>5}{'passed':>8}{'failed':>8}{'minutes':>9}", flush=True)
    command = [sys.executable, "-m", "pytest", "-q", "-m", "" if options.slow else "not slow"]
    command += ["-p", "benchmarks.seeds.run", "-p", "no:cacheprovider", *tests]
    failed = []
    for seed in range(1, seeds + 1):
        for name, variables in SETS.items():
            began = time.monotonic()
            paths = {"PYTHONPATH": str(common.PROJECT), "BENCHMARK_SEED": str(seed)}
            process = subprocess.run(
                command, env=os.environ | paths | variables, capture_output=True, text=True
            )
            count = {w: re.search(rf"(\d+) {w}", process.stdout) for w in ("passed", "failed")}
            cells = "".join(f"{int(c[1]) if c else 0:8d}" for c in count.values())
            print(f"{name:14}{seed:5d}{cells}{(time.monotonic() - began) / 60:9.1f}", flush=True)
            fell = re.findall(r"^(?:FAILED|ERROR) (\S+)", process.stdout, re.MULTILINE)
            if process.returncode and not fell:
                fell = [(process.stdout + process.stderr).strip().splitlines()[-1]]
            failed += [f"{name}, seed {seed}: {test}" for test in fell]
    common.finish(failed)


if __name__ == "__main__":
    main()
