"""Log evidence beside closed forms and beside nested sampling.

    python -m benchmarks.evidence.run          (needs dynesty, and brfd/ under MFD_BAYES_DATA)

Twenty linear models with Gaussian priors, whose evidence is known, and four real records with the
three stages and with LuGre. There dynesty integrates the same product of prior and likelihood. It
starts from a Gaussian that is twice as wide as the posterior in place of the prior (the likelihood
takes up the ratio), since its error grows with the distance that it has to shrink. Exit status 1: a
limit was missed. evidence.txt is what it prints.
"""

import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from scipy import stats
from scipy.special import ndtri

import mfd_bayes as mb
from benchmarks.common import data_folder
from mfd_bayes.calibration.priors import Prior, PriorFile

RECORDS = ["2023_36lb_0.50Hz_1.0in", "2023_36lb_0.25Hz_0.5in"]
RECORDS += ["2022_35lb_0.50Hz_1.0in", "2022_80lb_1.00Hz_1.0in"]
FIXED = Prior("fixed", {"value": 0.0})
LIMITS = {"Gaussian": 0.02, "real": 0.15}  # nats
TOGETHER, LIVE = 64, 1000


def linear(dim: int, seed: int) -> tuple[mb.Posterior, float]:
    """A posterior of a force that is linear in its parameters, and its log evidence."""
    rng, noise, names = np.random.default_rng(seed), 0.2, [f"a{k}" for k in range(dim)]

    class Linear(mb.Model):
        name = f"linear_{dim}"
        parameters = tuple(mb.Parameter(key, "kip", prior="real") for key in names)

        def force(self, theta, trace):
            return theta @ np.cos(np.outer(np.arange(1, dim + 1), trace.displacement))

    time = np.linspace(0.0, 6.0, 150)
    x = 2.0 * np.sin(2.0 * time) + 0.1 * rng.standard_normal(time.size)
    means, sds = rng.normal(size=dim), rng.uniform(0.3, 1.5, dim)
    design = np.cos(np.outer(x, np.arange(1, dim + 1)))
    force = design @ rng.normal(means, sds) + noise * rng.standard_normal(time.size)
    figures = zip(names, means.tolist(), sds.tolist(), strict=True)
    priors = {key: Prior("normal", {"mean": m, "sd": s}) for key, m, s in figures}
    priors |= {"offset": FIXED, "noise_sd": Prior("fixed", {"value": noise})}
    covariance = design @ np.diag(sds**2) @ design.T + noise**2 * np.eye(time.size)
    exact = stats.multivariate_normal(design @ means, covariance).logpdf(force)
    trace, file = mb.Trace.from_arrays(time, x, force=force), PriorFile(Path(), "", priors, {})
    return mb.Posterior(trace, file, "iid", Linear()), float(exact)


class Batches:
    """Density and pool for dynesty: the threads of a map have theirs computed together."""

    def __init__(self, density):
        self.density, self.lock = density, threading.Condition()
        self.busy, self.points, self.answers = 0, {}, {}

    def __call__(self, point):
        """Log density of a point, once every other thread waits for one or has ended."""
        me = threading.get_ident()
        with self.lock:
            self.points[me] = point
            self.compute()
            self.lock.wait_for(lambda: me in self.answers)
            return self.answers.pop(me)

    def compute(self):
        """Compute the densities of the threads if all of them wait."""
        if self.points and len(self.points) == self.busy:
            values = self.density(np.array(list(self.points.values()))).tolist()
            self.answers |= dict(zip(self.points, values, strict=True))
            self.points = {}
            self.lock.notify_all()

    def map(self, function, arguments):
        """Results of a function of each argument."""
        if len(arguments) > TOGETHER:
            first, rest = arguments[:TOGETHER], arguments[TOGETHER:]
            return self.map(function, first) + self.map(function, rest)

        def work(argument):
            try:
                return function(argument)
            finally:
                with self.lock:
                    self.busy -= 1
                    self.compute()

        self.busy = len(arguments)
        with ThreadPoolExecutor(self.busy) as pool:
            return list(pool.map(work, arguments))


def nested(posterior: mb.Posterior, draws: mb.Draws) -> tuple[float, float]:
    """Log evidence of dynesty and its error."""
    import dynesty

    flat = draws.q.reshape(-1, posterior.dim)
    middle, factor = flat.mean(axis=0), 2.0 * np.linalg.cholesky(np.cov(flat.T))
    log_det = np.log(np.diag(factor)).sum()

    def density(z):
        ratio = posterior.log_prob(middle + z @ factor.T) - stats.norm.logpdf(z).sum(axis=1)
        return np.maximum(ratio + log_det, -1e10)

    batches = Batches(density)
    sampler = dynesty.NestedSampler(
        batches, ndtri, posterior.dim, nlive=LIVE, sample="rwalk", bound="single",
        pool=batches, queue_size=TOGETHER, rstate=np.random.default_rng(1),
    )  # fmt: skip
    sampler.run_nested(dlogz=0.01, print_progress=False)
    return float(sampler.results.logz[-1]), float(sampler.results.logzerr[-1])


def main() -> None:
    worst = dict.fromkeys(LIMITS, 0.0)
    print(f"{'case':34} dim   log evidence ± se      k  exact or dynesty ± se  difference")

    def compare(kind, name, posterior, exact=None):
        draws = mb.sample(posterior, "standard", 1)
        mine = draws.log_evidence(posterior, 1)
        theirs, error = (exact, 0.0) if exact is not None else nested(posterior, draws)
        less = mine.value - theirs
        worst[kind] = max(worst[kind], abs(less))
        text = f"{name:34} {posterior.dim:3} {mine.value:14.3f} {mine.error:.3f} "
        print(text + f"{mine.pareto_k:6.2f} {theirs:16.3f} {error:.3f} {less:11.3f}", flush=True)

    for seed in range(20):
        compare("Gaussian", f"linear {seed}", *linear(2 + seed % 10, seed))
    for name in RECORDS:
        trace = mb.read_record(data_folder() / f"brfd/{name}.csv").trace(rate=64.0)
        for model in ("three_stage", "lugre"):
            compare("real", f"{name} {model}", mb.Posterior(trace, "brfd", "ou", model))
    for kind, limit in LIMITS.items():
        print(f"{kind}: largest difference {worst[kind]:.3f} nats, limit {limit}")
    sys.exit(any(worst[kind] > limit for kind, limit in LIMITS.items()))


if __name__ == "__main__":
    main()
