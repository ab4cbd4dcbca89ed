"""Parameter sets of each model that no run is behind, and its Python step along a motion."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.applications.export.c_source import source, table
from mfd_bayes.applications.export.compiled import compiler
from mfd_bayes.applications.export.sets import Laws, ParameterSets
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.friction.models import MODELS

PRIORS = load_priors("mfd").parameters
GRID = np.union1d(np.geomspace(0.2, 4.0, 15), [1.0])
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror")
needs_compiler = pytest.mark.skipif(not compiler(), reason="there is no compiler of C here")


def made_sets(name, n, seed=1):
    """Draws of a model from the priors, with laws and deviations from these of their own."""
    rng, model = np.random.default_rng(seed), MODELS[name]
    values = {key: prior.draw(rng, n) for key, prior in PRIORS.items()}
    theta = model.theta(values | {"gamma1": np.ones(n)})
    deviation = np.cumsum(0.05 * rng.standard_normal((n, len(model.laws), GRID.size)), axis=2)
    deviation -= deviation[:, :, [int(np.flatnonzero(GRID == 1.0)[0])]]
    size = n, len(model.laws)
    laws = Laws(rng.uniform(0.0, 1.0, size), rng.uniform(0.3, 2.0, size), deviation)
    ends = (0.2, 3.0), (0.0, 6.0)
    names = tuple(map(str, range(1, n + 1)))
    return ParameterSets(
        model, names, theta, rng.uniform(0, 1, n), laws, 1.0, 0.9, GRID, *ends, "ksi"
    )


def chosen(sets, rows):
    """Some of the sets."""
    rows = list(rows)
    laws = Laws(*(values[rows] for values in sets.laws))
    names = tuple(sets.names[row] for row in rows)
    return replace(sets, names=names, theta=sets.theta[rows], start=sets.start[rows], laws=laws)


def stepped(sets, time, x, v, p, *, alone=False):
    """Force of every set by `Model.step`, (n, T), kip; all together, or each `alone`."""
    if alone:
        rows = ([row] for row in range(len(sets.names)))
        return np.concatenate([stepped(chosen(sets, row), time, x, v, p) for row in rows])
    model, force = sets.model, np.empty((len(sets.names), len(time)))
    state = model.start(sets.theta, sets.start)
    dt = np.diff(time, prepend=time[0])
    for k, (size, place, speed, level) in enumerate(zip(dt, x, v, p, strict=True)):
        scales = sets.factors(level)
        force[:, k], state = model.step(state, place, speed, size, scales=scales)
    return force


def built(folder, sets, program, *flags, name="program"):
    """A program of C with some sets, compiled in a folder."""
    for file in ("damper.h", "damper.c"):
        (folder / file).write_text(source(file))
    (folder / "damper_sets.c").write_text(table(sets))
    (folder / "main.c").write_text(program)
    words = (*compiler(), *WARNINGS, *flags, "damper.c", "damper_sets.c", "main.c", "-lm")
    subprocess.run([*words, "-o", name], cwd=folder, check=True)
    return folder / name
