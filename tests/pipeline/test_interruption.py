"""Real processes, killed at random moments: files left behind, and resumed runs.

benchmarks/interruption does the same more often, with the whole report and on a cluster too.
"""

import fcntl
import json
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.cli.commands import app
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.runs.folder import discard

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not Path("/proc/self/stat").is_file(), reason="looks for processes in Linux's /proc"
    ),
]


@pytest.fixture(scope="module")
def study(benchmark_module, without_figures) -> ModuleType:
    """The benchmark's harness, running the command without figures."""
    module = benchmark_module("interruption.harness")
    module.heed_interrupts()
    module.COMMAND = without_figures
    return module


@pytest.fixture(scope="module")
def campaign(study, tmp_path_factory) -> Path:
    """The benchmark's campaign, with a model and a noise that take less time."""
    path = study.lay_out(tmp_path_factory.mktemp("campaign"))
    path.write_text(path.read_text().replace('"three_stage"', '"lugre"').replace('"ou"', '"iid"'))
    return path


@pytest.fixture(scope="module")
def whole(study, campaign, tmp_path_factory):
    """Run folder of the undisturbed run, and how it ended."""
    out = tmp_path_factory.mktemp("whole") / "disk" / "out"
    out.parent.mkdir()
    began = time.monotonic()
    ended = study.end(study.calibrate(campaign, out, 2), out, began)
    assert (ended.code, ended.complaint) == (0, "")
    return out, ended


@pytest.fixture
def out(tmp_path):
    (tmp_path / "disk").mkdir()
    return tmp_path / "disk" / "out"


@pytest.fixture
def copied(whole, out):
    return Path(shutil.copytree(whole[0], out))


def command(campaign, out, *options):
    """Outcome of the command in this process."""
    words = ("calibrate", campaign, "-o", out, "--effort", "quick", *options)
    return CliRunner().invoke(app, [str(word) for word in words])


def refused(outcome, *words):
    assert outcome.exit_code == 2, (outcome.output, outcome.exception)
    (sentence,) = outcome.stderr.splitlines()
    for word in words:
        assert word in sentence


def assert_sound(study, out, ended, reference):
    """Assert that no process remains, no file is half written, and the output is a sentence."""
    assert ended.orphans == 0
    assert len(ended.complaint.splitlines()) <= 1, ended.complaint
    assert [f for f in study.differing(out, reference) if f not in study.TIMED] == []


def assert_same(study, out, reference):
    assert study.files(out) == study.files(reference)
    assert study.differing(out, reference) == []


# --- signals


def wait_until_signals_are_heard(process):
    """Wait until the command handles SIGTERM: before that, imports of the driver are going on."""
    status = Path(f"/proc/{process.pid}/status")
    while process.poll() is None:
        caught = int(re.search(r"SigCgt:\s*(\w+)", status.read_text())[1], 16)
        if caught >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.01)


def test_a_run_ended_again_and_again_is_finished_to_the_same_bits(study, campaign, whole, out):
    reference, undisturbed = whole
    rng = np.random.default_rng(2)
    jobs, came = 2, 0
    for kind in rng.permutation(["SIGINT", "SIGTERM", "SIGKILL"]):
        began = time.monotonic()
        process = study.calibrate(campaign, out, jobs, "--resume")
        wait_until_signals_are_heard(process)
        came += study.disturb(kind, process, 0.3 + 0.7 * rng.random() * undisturbed.seconds)
        ended = study.end(process, out, began)
        assert ended.code in (0, study.EXITS[kind])
        if ended.code in (130, 143):
            assert ended.complaint.startswith("mfd-bayes: interrupted")
            assert "--resume" in ended.complaint
        assert_sound(study, out, ended, reference)
        jobs = 3 - jobs
    assert came
    ended = study.end(study.calibrate(campaign, out, jobs, "--resume"), out, time.monotonic())
    assert (ended.code, ended.complaint) == (0, "")
    assert_same(study, out, reference)


def test_a_test_whose_process_is_killed_begins_again(study, campaign, whole, out):
    process = study.calibrate(campaign, out, 2)
    assert study.disturb("worker", process, 0.3)  # a fit may take less than a second
    ended = study.end(process, out, time.monotonic())
    assert (ended.code, ended.complaint) == (0, "")
    (line,) = [line for line in ended.printed.splitlines() if "killed" in line]
    assert line.startswith("processes: note: one was killed; begins again: ")
    assert_sound(study, out, ended, whole[0])
    assert_same(study, out, whole[0])


# --- a full disk


@pytest.fixture
def disk(study, out):
    """Put a small disk under the run folder; a call makes it larger."""
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root can mount a small tmpfs")
    try:
        study.mount(out.parent, 16 * 1024)
    except subprocess.CalledProcessError:
        pytest.skip("this system does not let root mount a tmpfs")
    yield lambda size: study.mount(out.parent, size, again=True)
    study.unmount(out.parent)


def test_a_full_disk_is_said_in_a_sentence_and_resumed_when_there_is_room(
    study, campaign, whole, out, disk
):
    reference, _ = whole
    posterior = next(reference.rglob("posterior.nc")).stat().st_size
    for size, jobs in ((16 * 1024, 1), (int(1.5 * posterior), 2)):
        disk(size)
        process = study.calibrate(campaign, out, jobs, "--resume")
        ended = study.end(process, out, time.monotonic())
        assert ended.code == 2
        assert ended.complaint.startswith(f"mfd-bayes: cannot write {out}")
        assert ended.complaint.endswith("No space left on device\n")
        assert not list(out.rglob(".*"))
        assert_sound(study, out, ended, reference)
    disk(2**26)
    ended = study.end(study.calibrate(campaign, out, 2, "--resume"), out, time.monotonic())
    assert (ended.code, ended.complaint) == (0, "")
    assert_same(study, out, reference)


@pytest.mark.parametrize("over", [False, True])
def test_a_disk_that_becomes_read_only_is_said_in_a_sentence_and_resumed_when_it_is_not(
    study, campaign, whole, out, disk, over
):
    reference, _ = whole
    disk(2**26)
    process = study.calibrate(campaign, out, 2)
    while process.poll() is None and not any(out.glob("tests/*/posterior.nc")):
        time.sleep(0.02)
    study.forbid_writing(out.parent, over=over)
    ended = study.end(process, out, time.monotonic())
    assert ended.code == 2
    assert ended.complaint.startswith("mfd-bayes: cannot ")
    assert ended.complaint.endswith("Read-only file system\n")
    assert_sound(study, out, ended, reference)
    study.allow_writing(out.parent)
    ended = study.end(study.calibrate(campaign, out, 1, "--resume"), out, time.monotonic())
    assert (ended.code, ended.complaint) == (0, "")
    assert_same(study, out, reference)


def test_a_full_disk_under_the_log_is_said_in_a_sentence(study, campaign, copied):
    words = ("calibrate", str(campaign), "-o", str(copied), "--effort", "quick", "--resume")
    with Path("/dev/full").open("w") as full:
        outcome = subprocess.run(
            [*study.COMMAND, *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert outcome.returncode == 2
    assert outcome.stderr == "mfd-bayes: cannot write the output: No space left on device\n"


# --- what is left behind


def plan_of(path, **options):
    return plan_campaign(path, Options(effort="quick", **options))


def test_a_folder_without_its_first_manifest_is_begun(campaign, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".manifest.json.ab12cd34.part").write_text("{")
    seen = []

    def stop(step):
        seen.append(step)
        raise InterruptedError

    with pytest.raises(InterruptedError):
        calibrate(plan_of(campaign, resume=True), tmp_path / "out", stop)
    assert seen
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["status"] == "running"
    assert not list((tmp_path / "out").rglob(".*"))
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("content", ["", '{"status": "run', "[]", "{}"])
def test_a_damaged_manifest_is_refused_and_replaced_by_force(campaign, copied, content):
    (copied / "manifest.json").write_text(content)
    refused(command(campaign, copied, "--resume"), str(copied), "cannot be resumed", "--force")
    discard(copied)
    assert not any(copied.iterdir())


def test_what_was_being_discarded_is_not_resumed(campaign, copied, monkeypatch):
    def stop(path):
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "rmtree", stop)
    with pytest.raises(KeyboardInterrupt):
        discard(copied)
    monkeypatch.undo()
    assert list(copied.rglob("posterior.nc"))  # of another seed, it may be

    def look(step):
        assert not list(copied.rglob("posterior.nc"))
        raise InterruptedError

    with pytest.raises(InterruptedError):
        calibrate(plan_of(campaign, seed=7, resume=True), copied, look)
    assert json.loads((copied / "manifest.json").read_text())["seed"] == 7


def test_what_cannot_be_removed_is_not_taken_for_new(campaign, copied, monkeypatch):
    def fail(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(shutil, "rmtree", fail)
    refused(command(campaign, copied, "--force"), "cannot remove", "Permission denied")


def test_a_folder_that_another_process_works_on_is_refused(campaign, copied):
    folder = os.open(copied, os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    try:
        for option in ("--resume", "--force"):
            refused(command(campaign, copied, option), "another process", str(copied))
    finally:
        os.close(folder)
    assert list(copied.rglob("posterior.nc"))


# --- what has changed


@pytest.fixture(scope="module")
def ended_at_its_start(campaign, tmp_path_factory):
    """Folder of a campaign with its own priors, and of a run stopped at its start."""
    home = tmp_path_factory.mktemp("ended")
    folder = Path(shutil.copytree(campaign.parent, home / "campaign"))
    shutil.copy(Path(__file__).parents[2] / "priors" / "mfd.toml", folder)
    path = folder / "campaign.toml"
    path.write_text(path.read_text().replace('priors = "mfd"', 'priors = "mfd.toml"'))

    def stop(step):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        calibrate(plan_of(path), home / "out", stop)
    return home


@pytest.fixture
def unfinished(ended_at_its_start, tmp_path):
    home = Path(shutil.copytree(ended_at_its_start, tmp_path / "home"))
    return home / "campaign", home / "out"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--seed", 2), ("seed changed",)),
        (("--effort", "standard"), ("effort", "changed")),
    ],
)
def test_what_has_changed_is_named_and_not_resumed(unfinished, options, words):
    folder, out = unfinished
    before = (out / "manifest.json").read_bytes()
    refused(command(folder / "campaign.toml", out, "--resume", *options), *words, "--force")
    assert (out / "manifest.json").read_bytes() == before


@pytest.mark.parametrize("name", ["mfd_bayes", "python", "numpy", "scipy", "emcee"])
def test_another_version_does_not_resume(unfinished, name):
    folder, out = unfinished
    manifest = json.loads((out / "manifest.json").read_text())
    manifest["versions"][name] = "0.0.1"
    (out / "manifest.json").write_text(json.dumps(manifest))
    outcome = command(folder / "campaign.toml", out, "--resume")
    refused(outcome, f"versions ({name}) changed", "--force")


def test_a_campaign_that_bears_the_name_of_its_priors_does_not_hide_behind_them(campaign, tmp_path):
    folder = Path(shutil.copytree(campaign.parent, tmp_path / "campaign"))
    (folder / "campaign.toml").rename(folder / "mfd.toml")
    inputs = plan_campaign(folder / "mfd.toml", Options(effort="quick")).manifest.inputs
    assert {"mfd.toml", "priors/mfd.toml"} <= set(inputs)


# --- hashes of what is stored


def stored_hashes(out):
    return json.loads((out / "manifest.json").read_text())["files"]


def test_every_stored_file_has_its_hash(whole):
    out, _ = whole
    names = {path.relative_to(out).as_posix() for path in out.rglob("*.nc")}
    assert set(stored_hashes(out)) == {*names, "priors.toml"}


@pytest.mark.parametrize("name", ["tests/a/posterior.nc", "population.nc"])
def test_a_file_that_was_changed_is_not_gone_on_with(campaign, copied, name):
    path = copied / name if (copied / name).is_file() else next(copied.rglob("posterior.nc"))
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    refused(command(campaign, copied, "--resume"), path.name, "SHA-256")


def test_a_kill_between_a_file_and_its_hash_is_resumed(campaign, copied):
    before = stored_hashes(copied)
    manifest = json.loads((copied / "manifest.json").read_text())
    manifest |= {"status": "running", "files": {}}
    for entry in manifest["tests"].values():
        entry["status"] = "waiting"
    (copied / "manifest.json").write_text(json.dumps(manifest))
    outcome = command(campaign, copied, "--resume")
    assert outcome.exit_code == 0, outcome.output
    after = stored_hashes(copied)
    assert set(after) == set(before)
    kept = [name for name in before if name.endswith("posterior.nc")]
    assert {name: after[name] for name in kept} == {name: before[name] for name in kept}
