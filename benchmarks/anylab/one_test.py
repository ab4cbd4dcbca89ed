"""Four devices from 10 N to 2 MN: one test of each, with the campaign and priors of `init`.

    python -m benchmarks.anylab.one_test 0     # … 3; 12 s of processor each
    python -m benchmarks.anylab.one_test same  # one test in N and mm, and in kip and in; 12 s

prints how many of the true values that the data inform lie inside their 95 % intervals, with those
that do not, and for `same` the largest difference of a draw in its standard deviations. The tables
stand in anylab.txt.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from benchmarks.anylab.run import complete
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.calibration.sampling import Draws, sample
from mfd_bayes.cli.commands import app
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.records.record import read_record
from mfd_bayes.units import factor
from tests.pipeline.devices import DEVICES, Device, write_device

TEST = "6bar_0.5Hz"
_SIGNED = ("offset", "start")


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if sys.argv[1] == "same":
            print(same(folder))
        else:
            print(line_of(DEVICES[int(sys.argv[1])], folder))


def line_of(device: Device, folder: Path) -> str:
    begin = time.process_time()
    truth = write_device(folder, device)[TEST]
    plan = plan_campaign(prepared(folder, device), Options(effort="quick"))
    task = next(task for task in plan.tasks if task.id == TEST)
    posterior = task.posterior()
    draws = sample(posterior, effort="quick", seed=1)
    prior = posterior.draw_prior(np.random.default_rng(0), 2000)
    known = [k for k in truth if k in draws.values and k != "gamma1"]
    inside = {k: holds(draws, k, truth[k]) for k in known if informed(k, draws, prior)}
    missed = ", ".join(k for k, held in inside.items() if not held) or "none"
    words = [
        plan.system.words([value], "kip", 3)
        for value in (float(np.median(draws.values["Fc_fwd"])), truth["Fc_fwd"])
    ]
    return (
        f"{device.name:20} {plan.priors.path.name:12} inside {sum(inside.values()):2d} of "
        f"{len(inside):2d}, outside: {missed}; R-hat {draws.convergence.worst_r_hat:.3f}; "
        f"Fc_fwd {words[0]}, true {words[1]}; {time.process_time() - begin:.0f} s"
    )


def prepared(folder: Path, device: Device) -> Path:
    """Campaign file that `init` writes, with the units that it marks FIXME, and its priors."""
    campaign, runner = folder / "campaign.toml", CliRunner()
    assert runner.invoke(app, ["init", str(folder)]).exit_code == 0
    if not device.named:
        complete(campaign, device)
        assert runner.invoke(app, ["init", str(campaign)]).exit_code == 0
    return campaign


def informed(name: str, draws: Draws, prior: dict[str, np.ndarray]) -> bool:
    """Whether the data leave less than half of the prior's variance."""
    drawn, before = draws.values[name].ravel(), prior[name]
    if name not in _SIGNED:
        drawn, before = np.log(drawn), np.log(before)
    return bool(drawn.var() < 0.5 * before.var())


def holds(draws: Draws, name: str, value: float) -> bool:
    lower, upper = np.quantile(draws.values[name], [0.025, 0.975])
    return bool(lower <= value <= upper)


def same(folder: Path) -> str:
    """Largest difference of a draw between two systems of units, in its standard deviations."""
    device = DEVICES[0]
    write_device(folder, device)
    prepared(folder, device)
    rows = np.loadtxt(folder / f"{TEST}.txt", skiprows=2)
    by = [1.0, factor("mm", "displacement"), factor("N", "force")]
    found = []
    for length, force, table in (("mm", "N", rows), ("in", "kip", rows * by)):
        path = folder / f"{force}.txt"
        np.savetxt(path, table, "%.12g")  # rounded differently in each
        units = {"time": "s", "displacement": length, "force": force}
        numbers = {"time": 1, "displacement": 2, "force": 3}
        trace = read_record(path, numbers, units, "6 bar").trace(50.0)
        posterior = Posterior(trace, load_priors("priors.toml", folder), "ou", "lugre")
        found.append(sample(posterior, effort="quick", seed=1).q)
    apart = float(np.max(np.abs(found[0] - found[1]) / found[0].std(axis=(0, 1))))
    return f"{found[0].size} numbers in N and mm, and in kip and in: at most {apart:.1e} apart"


if __name__ == "__main__":
    main()
