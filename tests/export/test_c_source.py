"""The folder of C: it has no warnings, passes its self-test, and has the sheet's sets."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mfd_bayes import open_run
from mfd_bayes.applications.export.compiled import compiler
from mfd_bayes.applications.export.options import ExportOptions
from mfd_bayes.applications.export.samples import export
from mfd_bayes.applications.export.sets import check_model, parameter_sets
from mfd_bayes.applications.properties.datasheet import datasheet
from mfd_bayes.errors import CampaignError
from mfd_bayes.friction.models import MODELS
from tests.command_line import refusal, said
from tests.export.made import WARNINGS, built, made_sets, needs_compiler

FUZZ = (Path(__file__).parent / "fuzz.c").read_text()


@pytest.fixture(scope="module")
def exported(finished_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported") / "damper"
    said("export", finished_run.out, "--to", "c", "--draws", 12, "-o", folder)
    return folder


def self_test(folder, *flags):
    """Exit status and words of the self-test of a folder, compiled with flags."""
    words = (*compiler(), *WARNINGS, *flags, "damper.c", "damper_sets.c", "selftest.c", "-lm")
    subprocess.run([*words, "-o", "selftest"], cwd=folder, check=True)
    ended = subprocess.run(["./selftest"], cwd=folder, capture_output=True, text=True, check=False)
    return ended.returncode, ended.stdout


@needs_compiler
@pytest.mark.parametrize("flags", [["-O0"], ["-O3"], *([f"-DDAMPER_UNITS={k}"] for k in (1, 2, 3))])
def test_the_self_test_passes_without_a_warning_in_every_unit(exported, tmp_path, flags):
    folder = shutil.copytree(exported, tmp_path / "copy")
    status, words = self_test(folder, *flags)
    assert status == 0
    assert re.fullmatch(r"15 sets, largest error \d\.\de-1\d of the peak force: passed\n", words)


@needs_compiler
def test_the_self_test_sees_a_parameter_that_is_a_little_off(exported, tmp_path):
    folder = shutil.copytree(exported, tmp_path / "copy")
    text = (folder / "damper_sets.c").read_text()
    first = re.search(r'{"1", &device,\s*{([\d.]+)', text)[1]
    (folder / "damper_sets.c").write_text(text.replace(first, repr(float(first) * 1.000001), 1))
    status, words = self_test(folder)
    assert status == 1
    assert "set 1: code 0, error" in words
    assert "FAILED" in words


@needs_compiler
def test_fast_mathematics_are_refused_by_the_compiler(exported):
    words = [*compiler(), "-ffast-math", "-c", "damper.c", "-o", "/dev/null"]
    ended = subprocess.run(words, cwd=exported, capture_output=True, text=True, check=False)
    assert ended.returncode
    assert "compile without -ffast-math" in ended.stderr


@needs_compiler
@pytest.mark.skipif(not shutil.which("nm"), reason="there is no nm to list symbols with")
def test_there_are_no_globals_and_no_library_but_that_of_mathematics(exported, tmp_path):
    subprocess.run(
        [*compiler(), "-std=c99", "-O0", "-c", "damper.c", "-o", tmp_path / "damper.o"],
        cwd=exported,
        check=True,
    )
    listing = subprocess.run(
        ["nm", tmp_path / "damper.o"], capture_output=True, text=True, check=True
    ).stdout
    symbols = [line.split()[-2:] for line in listing.splitlines()]
    assert not [name for kind, name in symbols if kind in "bBdDC"]  # what can be written
    needed = {name for kind, name in symbols if kind == "U"}
    mathematics = {"copysign", "exp", "expm1", "log", "log1p", "pow", "sqrt", "tanh", "ceil"}
    assert needed <= mathematics | {
        "damper_sets",
        "damper_set_count",
        "memcpy",
        "memset",
        "_GLOBAL_OFFSET_TABLE_",
        "__stack_chk_fail",
    }
    assert {"exp", "tanh"} <= needed


@needs_compiler
@pytest.mark.parametrize("name", MODELS)
def test_sanitizers_are_silent_on_any_motion(name, tmp_path):
    """A step returns a code below 0 and leaves the state, or gives a finite force."""
    sanitizer = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    program = built(tmp_path, made_sets(name, 6), FUZZ, *sanitizer)
    ended = subprocess.run([program], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    counts = dict(zip(range(-4, 2), map(int, ended.stdout.split()), strict=True))
    assert min(counts[code] for code in (-3, -2, 0, 1)) > 20  # each of these was met


def test_slip_forces_of_the_sets_are_those_of_the_data_sheet(finished_run):
    run = open_run(finished_run.out)
    sets = parameter_sets(run, 1.0, 10)
    rows = datasheet(run).rows
    of_test = rows[(rows["actuation"] == 1.0) & (rows["quantity"] == "slip_force") & rows["tested"]]
    sheet = of_test.sort_values("direction", key=lambda d: d == "backward")
    expected = sheet[["nominal", "lower", "upper"]].to_numpy().T
    np.testing.assert_allclose(sets.slip, expected, rtol=1e-12)
    assert np.all(sets.slip[1] < sets.slip[0])
    more = parameter_sets(run, 1.0, 12)  # of however many draws
    np.testing.assert_array_equal(more.theta[:3], sets.theta[:3])
    assert np.ptp(more.theta[3:], axis=0).max() > 0.0
    # the forces themselves, read anew: in slip at mid-stroke, forward and backward
    trace = run.tests["p1000_f0.5"].trace
    force = sets.model.force(sets.theta[:3], trace, sets.start[:3])
    x, v = trace.displacement, trace.velocity
    near = (np.abs(x - 0.5 * (x.max() + x.min())) < 0.05 * np.ptp(x)) & (trace.time > 1.0)
    full = near & (np.abs(v) > 0.9 * np.abs(v).max())
    read = [[force[i, full & (v * s > 0)].mean() * s for s in (1, -1)] for i in range(3)]
    np.testing.assert_allclose(read, expected, rtol=0.02)
    # only friction differs between the three
    names = sets.model.parameters
    differs = {names[k] for k in np.flatnonzero(np.ptp(sets.theta[:3], axis=0))}
    assert differs == {"Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd"}


def test_factors_of_the_laws_are_the_population_s(finished_run):
    run = open_run(finished_run.out)
    sets = parameter_sets(run, 1.0, 8, seed=3)
    population = run.population
    index = population.draw_index(8, 1.0, np.random.default_rng([3, 0]))
    numbers = population.draw_numbers(8, sets.grid.size, np.random.default_rng([3, 1]))
    effects = population.level_effects(index, "", sets.grid, numbers.level)
    for level in (0.37, 0.9, 1.0, 2.2):
        expected = population.scales(run.model, np.array([level]), index, 1.0, effects)
        for name, values in expected.items():
            np.testing.assert_allclose(sets.factors(level)[name][3:], values[:, 0], rtol=1e-12)
    assert abs(sets.factors(2.2)["Fc_fwd"][0] - 1.0) > 0.5


def test_the_table_and_the_readme_say_what_the_sets_are(exported, finished_run):
    frame = pd.read_csv(exported / "parameters.csv")
    assert frame["set"].tolist() == ["nominal", "lower", "upper", *map(str, range(1, 13))]
    assert {"sigma0_kip_per_in", "v_s_in_per_s", "start", "Fc_fwd_share"} <= set(frame.columns)
    words = (exported / "README.txt").read_text()
    assert 130 <= len(words.split()) <= 180
    assert "They bound slip forces" in words
    assert "tested: 500 to 1500 psi" in words


def test_a_run_of_another_actuation_and_model_has_its_sets(small_run, tmp_path):
    export(ExportOptions(small_run, "c", tmp_path / "c", "500 psi", 10))
    assert "DAMPER_LUGRE, DAMPER_PRESSURE" in (tmp_path / "c" / "damper_sets.c").read_text()
    if compiler():
        assert self_test(tmp_path / "c")[0] == 0
    words = ("export", small_run, "--to", "c", "--actuation", "9000 psi", "-o", tmp_path / "far")
    assert "give --extrapolate" in refusal(*words)
    assert not (tmp_path / "far").exists()


def test_a_model_of_the_user_s_own_is_refused_with_what_to_do(made_run):
    run = open_run(made_run)
    campaign = run.manifest.settings.campaign.model_copy(update={"model": "viscous.py:Viscous"})
    settings = run.manifest.settings.model_copy(update={"campaign": campaign})
    own = replace(run, manifest=run.manifest.model_copy(update={"settings": settings}))
    with pytest.raises(CampaignError, match=r"in Python only: give --to csv .* run\.model\.step"):
        check_model(own, "--to c")
    check_model(run, "--to c")
