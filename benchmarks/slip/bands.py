"""A mechanism of how slip begins in the whole calibration: kinds of motion left out, with bands.

    python -m benchmarks.slip.bands > benchmarks/slip/bands.txt

calibrates the tests of 36 lbf at effort "quick" with `SelfEnergising` as a model of the user's own,
compiled (compiled.py) once it has been compared with that of mechanisms.py, and scores what was
left out as `benchmarks.heldout.run --kinds` does, whose table has `three_stage`, and with --model
backlash `backlash`. A model of the user's own is not thinned unless a rate is given: 128 Hz here.
Half an hour of two cores.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import mfd_bayes as mb
from benchmarks.heldout.run import kinds
from benchmarks.slip import compiled, mechanisms
from benchmarks.slip.run import GUESS
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign

TIME = np.arange(0, 10, 0.02)
HERE = Path(__file__).parent
OLD = '"brfd"', 'Fc_fwd = "power"\nFc_bwd = "power"\nFs_fwd = "power"\nFs_bwd = "power"'
NEW = '"priors.toml"\nrate = "128 Hz"', 'F_f = "power"\nF_b = "power"'


def planned(options, session):
    """Campaign of a tension's tests, and the folder of its run."""
    folder = options.out / f"{session}_self_energising"
    campaign = common.lay_out(
        options.data,
        options.out / f"campaign_{folder.name}",
        session,
        "compiled.py:SelfEnergising",
        common.FEW.get(session, ()) if options.quick else (),
    )
    text = campaign.read_text(encoding="utf-8")
    for old, new in zip(OLD, NEW, strict=True):
        text = text.replace(old, new)
    campaign.write_text(text, encoding="utf-8")
    for name in ("compiled.py", "priors.toml"):
        shutil.copyfile(HERE / name, campaign.parent / name)
    request = RunOptions(
        effort="quick", seed=options.seed, jobs=options.jobs, resume=folder.exists()
    )
    return plan_campaign(campaign, request), folder


def compare():
    """Exit where the compiled force is not that of mechanisms.py."""
    trace = mb.Trace.from_arrays(TIME, np.sin(np.pi * TIME), actuation=1.0)
    names = mechanisms.SelfEnergising().parameters
    theta, start = np.array([[0.9 * GUESS[name] for name in names]]), np.array([0.3])
    forces = [model.SelfEnergising().force(theta, trace, start) for model in (mechanisms, compiled)]
    if not np.allclose(*forces, rtol=0.0, atol=1e-10):
        common.finish(["the compiled force is not that of mechanisms.py"])


def said(step):
    """Print what is done."""
    print(step.id, step.stage, file=sys.stderr)


def main():
    parser = common.parser_of(__doc__, data=True, jobs=2, output="out_slip")
    options = common.begin(parser)
    compare()
    run = calibrate(*planned(options, "36lb"), said)
    others = SimpleNamespace(tests={task.id: task for task in planned(options, "30lb")[0].tasks})
    kinds(run, others, options.seed)


if __name__ == "__main__":
    main()
