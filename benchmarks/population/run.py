"""Is the inference across tests right on average? Ranks of truths over synthetic campaigns.

    python -m benchmarks.population.run > benchmarks/population/population.txt

takes a quarter of an hour of one core (--quick: one campaign, half a minute).

The hyperparameters, tests and records of small campaigns are drawn from the prior of the population
(study.py, which writes section 6 of model.md a second time). Their four short tests are calibrated,
and the population is inferred as users do. If all is right, the rank of the true value among L
draws is uniform (Talts et al. 2018), judged as in `benchmarks.sbc.run`; the bands of a new test
then hold it as often as they say. The controls take half of the scatter, and twice of it, and must
fail. The likelihood takes correlated noise for fewer samples, which is too careful for what a few
samples tell; --white has independent noise instead. No campaign is dropped. Finished ones are kept
in --out for a run that is broken off. Exit status 1: ranks are not uniform, a campaign has no
draws, or a control passes. How often the demo's intervals and bands hold the truth is asked by
`benchmarks.population.demo`.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import time
import warnings

import numpy as np

from benchmarks.population import study
from benchmarks.population.study import FACTORS, RIGHT
from mfd_bayes.errors import MfdError

CORRELATED, WHITE = 0.2, 0.004
"""Correlation times of the noise, s; samples are 0.06 s apart."""


def run_campaign(seed, index, noise_time):
    """Ranks of one campaign's truths each way, and how the sampling went."""
    warnings.simplefilter("ignore", FutureWarning)
    campaign = study.synthesize(seed, index, noise_time)
    began = time.perf_counter()
    try:
        draws, inference = study.infer(campaign)
    except MfdError as error:
        return {"error": str(error), "ranks": {}}
    convergence = inference.population.convergence
    single = all(d.convergence.reached(study.SINGLE.r_hat, study.SINGLE.ess) for d in draws)
    return {
        "error": "",
        "ranks": study.ranks_of(campaign, inference),
        "ess": convergence.worst_ess,
        "short": not (single and convergence.reached(study.JOINT.r_hat, study.JOINT.ess)),
        "seconds": time.perf_counter() - began,
    }


def tell_coverage(ranks, draws):
    """Print the shares of truths inside bands of a new test, with standard errors of these shares.

    As the ranks are whole numbers, bands of 90 and 95 % are told as the nearest that are possible.
    """
    shares = []
    for share in (0.5, 0.9, 0.95):
        outside = round((1.0 - share) / 2.0 * (draws + 1))
        shares.append((outside, 1.0 - 2.0 * outside / (draws + 1)))
    print(f"{'truths inside bands of':28}" + "".join(f"{share:>15.1%}" for _, share in shares))
    for name in (name for name in ranks if name.startswith("new")):
        values, words = np.array(ranks[name]), []
        for outside, share in shares:
            inside = np.mean((values >= outside) & (values <= draws - outside))
            error = np.sqrt(share * (1.0 - share) / values.size)
            words.append(f"{inside:9.1%} ±{error:5.1%}")
        print(f"{name:28}" + "".join(words), flush=True)


def judge(campaigns, draws):
    """Print the verdict on the package's way and on the controls; return what failed."""
    ranked = [c for c in campaigns if not c["error"]]
    failed = [f"campaign without draws: {c['error']}" for c in campaigns if c["error"]]
    print(
        f"{len(campaigns)} campaigns, none dropped; {sum(c['short'] for c in ranked)} fell short "
        f"of what was asked of their sampling\nL = {draws} draws of each, least ESS "
        f"{min(c['ess'] for c in ranked):.0f}; {np.median([c['seconds'] for c in ranked]):.0f} s a "
        "campaign (median)"
    )
    for way in FACTORS:
        ranks = {name: [c["ranks"][way][name] for c in ranked] for name in ranked[0]["ranks"][way]}
        words = "the package's way" if way == RIGHT else "negative control"
        prefixes = ("",) if way == RIGHT else ("scatter", "new")
        fell = common.ranks_table(ranks, draws, f"scatter as {way} ({words})", prefixes)
        tell_coverage(ranks, draws)
        if way == RIGHT:
            failed += [f"ranks of {name} are not uniform" for name in fell]
        elif not any(name.startswith("scatter") for name in fell):
            failed.append(f"the control, scatter {way}, has uniform ranks")
    return failed


def main():
    parser = common.parser_of(__doc__, jobs=1, output="out_population")
    parser.add_argument("--campaigns", type=int, default=100)
    parser.add_argument("--white", action="store_true", help="independent noise")
    options = common.begin(parser)
    noise_time = WHITE if options.white else CORRELATED
    count = 1 if options.quick else options.campaigns
    tasks = [(options.seed, index, noise_time) for index in range(count)]
    failed = judge(common.run_series(run_campaign, tasks, options), study.DRAWS)
    common.finish([] if options.quick else failed)


if __name__ == "__main__":
    main()
