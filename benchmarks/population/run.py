"""Whether the inference across tests is right: against NUTS, and by simulation.

    pip install -e '.[bench]'
    python -m benchmarks.population.run --campaigns 100 > benchmarks/population/population.txt

Agreement: one synthetic campaign of four tests at three levels, 17 parameters each, with
Ornstein–Uhlenbeck noise. Ours calibrates the tests and samples them jointly to 5000 effective
draws. NumPyro's NUTS samples the joint density of population and tests, written in JAX, which
shares no code with ours (`benchmarks.population.peer`). Both take what the joint fit fixes: the
discrepancy, the noise's shape, the share of independent samples, and which quantities of tests
stand apart. Every level, scatter, deviation, shape and quantity of a test must have a mean within
`MEAN` standard deviations, and a standard deviation within `SPREAD`, of those of NUTS. The control
has a prior of the scatter four times as wide, and has to fail.

Ranks: the hyperparameters, tests and records of small campaigns are drawn from the prior of the
population (`benchmarks.population.study`). Their four short tests are calibrated one by one, and
the population is inferred as users do. If all is right, the rank of the true value among L draws is
uniform (Talts et al. 2018), which is judged as in `benchmarks.sbc.run`. The controls take half of
the scatter, and twice of it, and have to fail. The likelihood takes correlated noise for fewer
samples, which is too careful for what a few samples tell (how sharply the gap closes); `--white`
has independent noise instead.

Every finished campaign is a file in --work, so an interrupted run goes on where it stopped. Files
made by other code or other settings are not used, and no campaign is dropped. Exit status 1: a
limit is exceeded, ranks are not uniform, a campaign has no draws, or a control passes.
"""

from __future__ import annotations

import os

# Read when numpy and JAX are imported, here and in the processes that this file starts.
os.environ.update(
    OMP_NUM_THREADS="1",
    OPENBLAS_NUM_THREADS="1",
    MKL_NUM_THREADS="1",
    JAX_PLATFORMS="cpu",
    XLA_FLAGS="--xla_cpu_multi_thread_eigen=false",
)

import argparse
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.machine import platform_line, print_bars
from benchmarks.common.series import fingerprint, run_series
from benchmarks.population import study as study_of
from benchmarks.population.study import FACTORS, RIGHT, WALKERS
from mfd_bayes.calibration.diagnostics import EFFORTS, measure
from mfd_bayes.errors import MfdError
from tests.statistical.uniformity import LEVEL, Uniformity, failures, rank_cells

MEAN, SPREAD = 0.1, 0.1
"""Largest deviations of a mean, in sds, and of the ratio of two sds from 1."""
CLOSE = 1e-8
"""Largest deviation of JAX's log likelihoods, over their size where that exceeds 1."""
CORRELATED, WHITE = 0.2, 0.004
"""Correlation times of the noise, s; samples are 0.06 s apart."""
CHAINS, TUNING, DRAWS = 4, 800, 2000
TESTS = ("test 1", "test 2", "test 3", "test 4")
GROUPS = ("level", "scatter", "deviation", "share", "exponent")
MAIN = ("sigma0", "Fc_fwd", "Fc_bwd", "k3", "d2", "offset", "noise_sd")
"""Quantities of the tests for which the bars hold, in shared coordinates: the slip forces, the
width of the gap, … Others have tails that no sampler here sees often enough for an sd."""
LEGEND = """\
p       of the simultaneous ECDF test of one quantity
z       mean rank less the uniform one, in standard errors
spread  sd of the ranks over the uniform one's: above 1 the posteriors are too narrow"""


# agreement


def compare(seed, quick, small):
    """Print how our draws agree with those of NUTS; return what failed."""
    from benchmarks.population import peer

    study = (study_of.small_study if small else study_of.full_study)(seed)
    study = replace(study, joint=replace(EFFORTS["thorough"], ess=5000, kept=32000))
    campaign = study_of.synthesize(study, 0)
    began = time.perf_counter()
    draws = study_of.calibrate(study, campaign, 0)
    calibrated = time.perf_counter() - began
    joint = study_of.fit_campaign(campaign, study.priors, draws)
    failed = _likelihoods_that_differ(joint)
    layout = peer.Layout(joint)
    began = time.perf_counter()
    tuning, kept = (400, 1000) if quick else (TUNING, DRAWS)
    found, diverged = peer.nuts(layout, chains=CHAINS, warm_up=tuning, kept=kept, seed=seed)
    theirs = peer.drawn_values(layout, found)
    spent = time.perf_counter() - began
    their_ess = sizes(theirs, 1)
    print(
        f"{len(campaign.tests)} tests of {study.motion.samples} samples, "
        f"{len(campaign.design.names)} quantities each; the tests by themselves took "
        f"{calibrated:.0f} s\nNUTS: {CHAINS} chains of {kept} draws, {diverged:.1%} diverged, "
        f"largest R-hat {rhat(theirs, 1):.3f}, least bulk ESS {min(their_ess.values()):.0f}, "
        f"{spent:.0f} s"
    )
    fell = _agree_with(study, joint, theirs, 1.0)
    control = _agree_with(study, joint, theirs, 4.0)
    if not control:
        return [*failed, *fell, "the control, a wider prior of the scatter, agrees too"]
    print(f"the control has to fail, and does: {len(control)} bars fall")
    return failed + fell


def _likelihoods_that_differ(joint):
    """Sentences on the tests whose log likelihood in JAX is not ours."""
    from benchmarks.population import peer

    failed = []
    for j in range(len(joint.fit.tests)):
        off = peer.deviation(joint, j, np.random.default_rng(j))
        if not off <= CLOSE:
            failed.append(f"JAX's log likelihood of test {j + 1} is off by {off:.1e}")
    return failed


def _agree_with(study, joint, theirs, wider):
    """Infer the population one way, print how it agrees with NUTS; return what failed."""
    began = time.perf_counter()
    drawn = study_of.draw_jointly(study, joint, wider)
    spent = time.perf_counter() - began
    mine = study_of.coordinates_of(joint.mixed.design, drawn)
    ess = sizes(mine, WALKERS)
    way = "whole" if wider == 1.0 else f"whole, prior of the scatter times {wider:g} (control)"
    tests, together = drawn.accepted
    print(
        f"\nours, tests as {way}: {drawn.sweeps} sweeps, {tests:.0%} and {together:.0%} of moves "
        f"accepted, largest R-hat {rhat(mine, WALKERS):.3f}, least bulk ESS "
        f"{min(ess.values()):.0f}, {spent:.0f} s"
    )
    return agreement(mine, theirs, ess, sizes(theirs, 1))


def agreement(mine, theirs, my_ess, their_ess):
    """Print the worst deviations by group, with Monte-Carlo errors; return what failed."""
    rows = {
        name: _deviation(mine[name], theirs[name], my_ess[name], their_ess[name]) for name in theirs
    }
    groups = {group: [name for name in rows if name.startswith(group)] for group in GROUPS}
    for test in TESTS:
        groups[test] = [f"{test}: {name}" for name in MAIN if f"{test}: {name}" in rows]
    groups["others"] = [n for n in rows if n.startswith(TESTS) and n.split(": ")[1] not in MAIN]
    print(f"{'':12s}{'mean':>8}{'error':>8}  {'':26s}{'sd':>8}{'error':>8}")
    failed = []
    for group, names in groups.items():
        if not names:
            continue
        at, there = (max(names, key=lambda name, i=i: abs(rows[name][i])) for i in (0, 2))
        (mean, error, _, _), (_, _, sd, sd_error) = rows[at], rows[there]
        print(f"{group:12s}{mean:8.3f}{error:8.3f}  {at:26s}{sd:8.1%}{sd_error:8.1%}  {there}")
        for name in names:
            mean, _, sd, _ = rows[name]
            failed += [] if abs(mean) <= MEAN else [f"mean of {name} is {mean:.3f} sd off"]
            failed += [] if abs(sd) <= SPREAD else [f"sd of {name} is {sd:.1%} off"]
    table = np.array(list(rows.values()))
    means, sds = (float(np.sqrt(np.mean((table[:, i] / table[:, i + 1]) ** 2))) for i in (0, 2))
    print(f"all {len(rows)} in their errors, root mean square: means {means:.2f}, sds {sds:.2f}")
    return failed


def _deviation(ours, other, my_ess, their_ess):
    """Deviation of the mean, in sds, and of the sd, each with its Monte-Carlo error."""
    mean = (ours.mean() - other.mean()) / other.std()
    errors = []
    for draws, ess in ((ours, my_ess), (other, their_ess)):
        squares = (draws - draws.mean()) ** 2
        errors.append(0.5 * squares.std() / squares.mean() / np.sqrt(ess))
    error = np.sqrt(1.0 / my_ess + 1.0 / their_ess)
    return mean, error, ours.std() / other.std() - 1.0, float(np.hypot(*errors))


def _found(values, walkers):
    """Convergence of draws by name, (chain, draw) each, which are ordered by walker."""
    stacked = np.stack(list(values.values()), axis=-1)
    chains = stacked.reshape(len(stacked), walkers, -1, stacked.shape[-1]).swapaxes(1, 2)
    return measure(chains)


def sizes(values, walkers):
    """Bulk effective sample sizes by name."""
    return dict(zip(values, _found(values, walkers).ess_bulk.tolist(), strict=True))


def rhat(values, walkers):
    """Largest R-hat."""
    return _found(values, walkers).worst_r_hat


# ranks


def run_campaigns(seed, count, work, jobs, noise_time):
    """Results of campaigns 0 to `count`; those of an earlier run are read from `work`."""
    study = study_of.small_study(seed, noise_time)
    settings = (dict(study.priors.parameters), dict(study.priors.scatter), study.single)
    settings = (*settings, study.joint, study.draws, study.seed)
    motion = study.motion.displacement.tobytes()
    rooms = ("records", "friction", "calibration", "population")
    folder = work / fingerprint(settings, motion, study_of.__file__, rooms)
    tasks = [
        (folder / f"{index}.json", run_campaign, (seed, index, noise_time))
        for index in range(count)
    ]
    return run_series(tasks, jobs, "campaigns")


def run_campaign(seed, index, noise_time):
    """Ranks of one campaign's truths both ways, and how the sampling went."""
    warnings.simplefilter("ignore", FutureWarning)
    study = study_of.small_study(seed, noise_time)
    campaign = study_of.synthesize(study, index)
    began = time.perf_counter()
    try:
        draws = study_of.calibrate(study, campaign, index)
        inference = study_of.infer(study, campaign, draws, index)
    except MfdError as error:
        return {"error": str(error), "ranks": {}}
    population = inference.population
    found = population.convergence
    single = all(d.convergence.reached(study.single.r_hat, study.single.ess) for d in draws)
    return {
        "error": "",
        "ranks": study_of.ranks_of(study, campaign, inference, index),
        "told": (found.worst_ess, found.worst_r_hat, inference.sweeps),
        "information": population.residual.information,
        "short": not (single and found.reached(study.joint.r_hat, study.joint.ess)),
        "seconds": time.perf_counter() - began,
    }


def judge(campaigns, study):
    """Print the verdict on the package's way and on the controls; return what failed."""
    ranked = [c for c in campaigns if not c["error"]]
    failed = [f"campaign without draws: {c['error']}" for c in campaigns if c["error"]]
    seconds = np.array([c["seconds"] for c in ranked])
    told = np.array([c["told"] for c in ranked])
    print(
        f"{len(campaigns)} campaigns, none dropped; {sum(c['short'] for c in ranked)} fell short "
        f"of what was asked of their sampling\nL = {study.draws} draws of each, least ESS "
        f"{told[:, 0].min():.0f}, largest R-hat {told[:, 1].max():.3f}, {told[:, 2].max():.0f} "
        f"sweeps at most; {np.median(seconds):.0f} s a campaign (median), "
        f"{seconds.sum() / 60:.0f} min in all on one core\n\n{LEGEND}"
    )
    uniformity = Uniformity(len(ranked), study.draws)
    for way in FACTORS:
        ranks = {name: [c["ranks"][way][name] for c in ranked] for name in ranked[0]["ranks"][way]}
        fell = failures(ranks, uniformity)
        words = "the package's way" if way == RIGHT else "negative control"
        print(
            f"\nscatter as {way} ({words}): {'NOT uniform' if fell else 'uniform'}, {len(fell)} of "
            f"{len(ranks)} quantities fail\nfamilywise {100 * LEVEL:g} % over {len(ranks)} "
            f"quantities by Bonferroni: p below {LEVEL / len(ranks):.2g} fails"
        )
        touched = {
            n: v for n, v in ranks.items() if way == RIGHT or n.startswith(("scatter", "new"))
        }
        print(f"{'quantity':28s}{'p':>10}{'z':>8}{'spread':>9}")
        for name, values in touched.items():
            line = f"{name:28s}{rank_cells(values, uniformity)}"
            print(line + ("  fails" if name in fell else ""))
        if way == RIGHT:
            failed += [f"ranks of {name} are not uniform" for name in fell]
        elif not any(name.startswith("scatter") for name in fell):
            failed.append(f"the control, scatter {way}, has uniform ranks")
    return failed


def parse():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=["agreement", "ranks"], help="one part alone")
    parser.add_argument("--quick", action="store_true", help="shorter chains of NUTS")
    parser.add_argument("--small", action="store_true", help="NUTS on one of the small campaigns")
    parser.add_argument("--white", action="store_true", help="ranks with independent noise")
    parser.add_argument("--work", type=Path, default=Path("out_population"), help="campaigns")
    return parser.parse_args()


def main():
    options = parse()
    warnings.simplefilter("ignore", FutureWarning)
    print(" ".join(["python -m benchmarks.population.run", *sys.argv[1:]]))
    print(f"{platform_line()}, numpy {np.__version__}")
    failed = []
    if options.only != "ranks":
        print("\nAgreement with NUTS on the joint density\n")
        failed += compare(options.seed, options.quick, options.small)
        sys.stdout.flush()
    if options.only != "agreement":
        print("\nRanks of truths drawn from the prior of the population\n")
        noise_time = WHITE if options.white else CORRELATED
        what = options.seed, options.campaigns, options.work, options.jobs, noise_time
        failed += judge(run_campaigns(*what), study_of.small_study(options.seed, noise_time))
    print_bars(failed)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
