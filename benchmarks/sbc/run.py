"""Are posteriors of one test right on average? Simulation-based calibration (Talts et al. 2018).

    python -m benchmarks.sbc.run > benchmarks/sbc/sbc.txt
    python -m benchmarks.sbc.run --model backlash > benchmarks/sbc/sbc_backlash.txt

takes two hours on two cores (--quick: a minute).

A test is a synthetic record. Every parameter, the start in the gap, the offset and the noise are
drawn from a prior that is narrowed to sensible loops; model and Ornstein-Uhlenbeck noise give the
force; then the posterior under the same prior is sampled. If all is right, the rank of the true
value among L nearly independent draws is uniform over 0 … L, and so is that of the log likelihood
(Modrák et al. 2023). Ranks are judged by a band that holds the whole ECDF (Säilynoja et al. 2022),
with Bonferroni's correction. The negative control assumes noise without correlation and must fail.
No test is dropped. Finished tests are kept in --out for a run that is broken off. Exit status 1:
ranks are not uniform, a test has no draws, or the control passes.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

from dataclasses import replace

import numpy as np

import mfd_bayes as mb
from mfd_bayes.calibration.effort import EFFORTS
from tests.statistical import sbc_study
from tests.statistical.sbc_study import TRUE, WRONG, Ranked


def study_of(seed, model, quick):
    """All parameters of a model, on two and a half cycles and four small ones inside the gap."""
    time = np.arange(320) / 32.0
    fade = 1.0 / (1.0 + np.exp((time - 6.6) / 0.15))
    large = 0.5 * np.sin(2 * np.pi * 0.4 * time)
    small = 0.05 * np.sin(2 * np.pi * 1.2 * time)
    motion = mb.Trace.from_arrays(time, large * fade + small * (1.0 - fade))
    # the effective sample size is three times the draws that are taken
    effort, draws = replace(EFFORTS["standard"], ess=200, limit=12000), 63
    if quick:
        effort, draws = replace(EFFORTS["quick"], ess=70, limit=400, ensembles=2, starts=4), 15
    return sbc_study.Study(sbc_study.narrow_priors(), motion, effort, draws, seed, model)


def run_test(seed, index, noise, model, quick):
    """Ranks of one test, as they are stored."""
    return vars(sbc_study.run_test(study_of(seed, model, quick), index, noise))


def show(noise, tests, study):
    """Print the verdict on a series of tests, quantity by quantity; which fail."""
    ranked = [test for test in tests if not test.error]
    purpose = "the right likelihood" if noise == TRUE else "negative control, a wrong likelihood"
    short = sum(not test.converged for test in ranked)
    print(
        f"\n{len(tests)} tests, none dropped: {len(ranked)} ranked, {short} of them stopped at the "
        f"limit of steps; {len(tests) - len(ranked)} without draws\n"
        f"L = {study.draws} draws of each, least ESS {min(t.ess for t in ranked):.0f}, largest "
        f"R-hat {max(t.r_hat for t in ranked):.3f}; "
        f"{np.median([t.seconds for t in ranked]):.1f} s a test (median)"
    )
    ranks = sbc_study.ranks_by_quantity(tests)
    return common.ranks_table(ranks, study.draws, f"{noise} noise assumed ({purpose})")


def main():
    parser = common.parser_of(__doc__, jobs=2, output="out_sbc")
    parser.add_argument("--tests", type=int, default=300)
    parser.add_argument("--control", type=int, default=100, help="tests of the wrong likelihood")
    parser.add_argument("--model", default="three_stage", help="three_stage or backlash")
    options = common.begin(parser)
    if options.quick:
        options.tests, options.control = 4, 2
    study = study_of(options.seed, options.model, options.quick)
    missed = []
    for noise, count in ((TRUE, options.tests), (WRONG, options.control)):
        words = (noise, options.model, options.quick)
        tasks = [(options.seed, index, *words) for index in range(count)]
        tests = [Ranked(**result) for result in common.run_series(run_test, tasks, options)]
        failed = show(noise, tests, study)
        missed += [f"{noise}: {test.error}" for test in tests if test.error]
        if bool(failed) != (noise == WRONG):
            missed.append(f"{noise} noise assumed: {', '.join(failed) or 'all'} uniform or not")
    common.finish([] if options.quick else missed)


if __name__ == "__main__":
    main()
