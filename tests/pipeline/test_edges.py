"""Extreme numbers in a record give a verdict or a one-sentence error."""

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.errors import MfdError
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.records.record import read_record

TIME = np.arange(200) / 50
MOTION = np.sin(np.pi * TIME)
FORCE = np.tanh(5 * np.cos(np.pi * TIME))
NAMES = ("time_s", "displacement_in", "force_kip", "pressure_psi")


def write(folder, **changed):
    """CSV file of a record whose columns are changed by name."""
    columns = dict(zip(NAMES, (TIME, MOTION, FORCE, np.full(200, 500.0)), strict=True)) | changed
    size = min(map(len, columns.values()))
    rows = np.column_stack([column[:size] for column in columns.values()])
    path = folder / "a.csv"
    np.savetxt(path, rows, "%.17g", ",", header=",".join(columns), comments="")
    return path


def plan(folder, actuation="500 psi", model="lugre"):
    path = folder / "campaign.toml"
    path.write_text(
        f'[campaign]\nmodel = "{model}"\nnoise = "iid"\n'
        f'[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "{actuation}"\n'
    )
    return plan_campaign(path, Options(effort="quick"))


def with_value(column, at, value):
    changed = np.array(column, dtype=float)
    changed[at] = value
    return changed


REFUSED = {
    "ten samples": ({"time_s": TIME[:10]}, "10 samples"),
    "a time twice": ({"time_s": with_value(TIME, 9, TIME[8])}, "does not increase at line 11"),
    "constant displacement": ({"displacement_in": np.ones(200)}, "is constant"),
    "zero force": ({"force_kip": np.zeros(200)}, "zero throughout"),
    "force of 1e12 kip": ({"force_kip": 1e12 * FORCE}, "too large to use"),
    "a counter that overflowed": ({"time_s": with_value(TIME, -1, 2.0**64)}, "too large to use"),
    "no turn": ({"displacement_in": TIME}, "0 turning points"),
}


def test_a_record_that_cannot_be_used_is_refused(tmp_path):
    for case in REFUSED:
        changed, words = REFUSED[case]
        write(tmp_path, **changed)
        with pytest.raises(MfdError, match=words):
            plan(tmp_path)


def test_a_force_of_any_size_that_is_taken_has_a_likelihood(tmp_path):
    for scale in [1e-12, 1e9]:
        for model in ["lugre", "three_stage", "bouc_wen", "backlash"]:
            write(tmp_path, force_kip=scale * FORCE)
            (task,) = plan(tmp_path, model=model).tasks
            posterior = Posterior(task.trace, task.priors, "iid", model)
            drawn = posterior.draw_prior(np.random.default_rng(1), 50)
            values = posterior.log_prob(posterior.coordinates(drawn))
            assert not np.any(np.isnan(values))
            assert np.any(np.isfinite(values))


def test_no_actuation_and_an_endless_one_are_refused(tmp_path):
    for actuation, words in [
        ("0 psi", "need an actuation above zero in at least one"),
        ("1e999 psi", "not finite"),
    ]:
        write(tmp_path)
        with pytest.raises(MfdError, match=words):
            plan(tmp_path, actuation)


def test_a_long_record_is_read_thinned_and_have_a_likelihood(tmp_path):
    time = np.arange(200_000) / 1000
    rows = np.column_stack([time, np.sin(0.2 * np.pi * time), np.cos(0.2 * np.pi * time)])
    path = tmp_path / "a.csv"
    lines = map("{:.3f},{:.5f},{:.5f}\n".format, *rows.T.tolist())
    path.write_text("time_s,displacement_in,force_kip\n" + "".join(lines))
    record = read_record(path, actuation="500 psi")
    assert record.time.size == 200_000
    trace = record.trace(gap=load_priors("mfd").gap)
    assert trace.samples < 200_000
    posterior = Posterior(trace)
    drawn = posterior.draw_prior(np.random.default_rng(1), 2)
    assert not np.any(np.isnan(posterior.log_prob(posterior.coordinates(drawn))))
