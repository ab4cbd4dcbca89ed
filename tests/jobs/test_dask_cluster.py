"""Real schedulers and workers of dask.distributed: their results, also when one is lost."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from mfd_bayes.applications.comparison.crossvalidation import folds_of, run_folds
from mfd_bayes.campaign.synthetic import Matrix, write_campaign
from mfd_bayes.jobs.job import Progress
from mfd_bayes.jobs.local import run_in_processes
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign
from mfd_bayes.runs.folder import posterior_of
from tests.command_line import refusal
from tests.run_folders import content

pytestmark = [
    pytest.mark.skipif(
        not (importlib.util.find_spec("distributed") and importlib.util.find_spec("threadpoolctl")),
        reason='needs the extra "cluster": pip install ".[cluster]"',
    ),
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="kills processes as Linux has them"),
]

MANY = {f"{name}_NUM_THREADS": "2" for name in ("OPENBLAS", "OMP", "MKL")}
ODD = 'p500 "ü" $(x); 1'


def until(condition, message):
    """The first true value of a function, called again and again."""
    limit = time.monotonic() + 120.0
    while time.monotonic() < limit:
        if answer := condition():
            return answer
        time.sleep(0.1)
    raise TimeoutError(message)


CLUSTER = """
import sys
from distributed import LocalCluster

local = LocalCluster(
    n_workers=1, threads_per_worker=2, local_directory=sys.argv[1], dashboard_address=None
)
print(local.scheduler_address, flush=True)
sys.stdin.read()
local.close()
"""


@contextmanager
def cluster(folder):
    """A process with a scheduler, its address, and a worker that does two tests at a time.

    It gives up a test whose workers are lost twice. The environment asks for several threads.
    """
    environment = os.environ | MANY | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
    with (
        (folder / "log.txt").open("w") as log,
        subprocess.Popen(
            [sys.executable, "-c", CLUSTER, folder],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env=environment,
        ) as process,
    ):
        yield process, process.stdout.readline().strip()


def ask(address):
    from distributed import Client

    return Client(address, set_as_default=False)


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    with cluster(tmp_path_factory.mktemp("cluster")) as (_, address):
        yield address


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Campaign of two tests that take a second or two each."""
    folder = tmp_path_factory.mktemp("campaign")
    matrix = Matrix(
        pressures=(500.0, 1000.0), frequencies=(0.5,), cycles=(1,), held_out=(800.0, 0.5)
    )
    write_campaign(folder, 1, matrix)
    path = folder / "campaign.toml"
    text = path.read_text().replace('"three_stage"', '"lugre"')
    path.write_text(text.replace('"ou"', '"iid"\nrate = "25 Hz"'))
    return path


@pytest.fixture(scope="module")
def tasks(campaign):
    """The jobs of the tests, one with a name full of special characters."""
    task_a, task_b = plan_campaign(campaign, RunOptions(effort="quick")).tasks
    return replace(task_a, id=ODD, file=posterior_of(ODD)), task_b


@pytest.fixture(scope="module")
def reference(tasks, tmp_path_factory):
    """Posteriors of the tests by one process of this machine."""
    folder = tmp_path_factory.mktemp("reference")
    list(run_in_processes(tasks, folder, 1, lambda _: None))
    return folder


@pytest.fixture(scope="module")
def whole(campaign, tmp_path_factory):
    """A whole run by one process of this machine."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    calibrate(plan_campaign(campaign, RunOptions(effort="quick", jobs=1)), folder, lambda _: None)
    return folder


def stored(folder):
    return {p.relative_to(folder).as_posix(): content(p) for p in sorted(folder.rglob("*.nc"))}


def command(campaign, folder, address, *options):
    words = ("calibrate", campaign, "-o", folder, "--effort", "quick", "--scheduler", address)
    return [str(word) for word in (*words, *options)]


def on_cluster(*arguments):
    from mfd_bayes.jobs.dask_cluster import run_on_cluster

    return run_on_cluster(*arguments)


# --- what comes of it


def test_draws_are_those_of_one_process_to_the_last_bit(address, tasks, reference, tmp_path):
    events = []
    outcomes = list(on_cluster(tasks, tmp_path, address, events.append))
    assert {(o.id, o.status) for o in outcomes} == {(task.id, "done") for task in tasks}
    assert stored(tmp_path) == stored(reference)
    assert not list(tmp_path.rglob("*.part"))
    for task in tasks:  # as a table shows them
        steps = [step for step in events if step.id == task.id]
        assert [s.stage for s in steps[:2]] == ["waiting", "finding modes"]
        assert {s.stage for s in steps[2:-1]} == {"sampling"}
        assert steps[-1].stage == "done"
        assert isinstance(steps[-1].progress, Progress)
        assert steps[-1].progress.steps == steps[-2].progress.steps


def test_folds_of_a_cross_validation_need_no_shared_folder(address, whole):
    from mfd_bayes.runs.run import open_run

    run = open_run(whole)
    folds = folds_of(run, "test", "quick")
    predictions = run_folds(
        run, folds, RunOptions(effort="quick", scheduler=address), lambda _: None
    )
    for fold in folds:
        (whole / "crossvalidation" / fold.file).unlink()
    assert predictions == run_folds(run, folds, RunOptions(effort="quick", jobs=1), lambda _: None)


# --- losses


def test_a_test_whose_worker_is_killed_begins_again(address, tasks, reference, tmp_path):
    events = []

    def observe(step):
        if step.stage == "finding modes" and not any(s.stage == step.stage for s in events):
            with ask(address) as client:
                pids = client.run(os.getpid)
            os.kill(*pids.values(), signal.SIGKILL)
        events.append(step)

    (outcome,) = on_cluster(tasks[:1], tmp_path, address, observe)
    assert outcome.status == "done"
    (again,) = [step for step in events if step.stage == "begins again:"]
    assert "was lost" in again.message
    name = f"tests/{ODD}/posterior.nc"
    assert stored(tmp_path)[name] == stored(reference)[name]


def test_a_lost_scheduler_ends_the_run_which_resume_finishes(campaign, whole, tmp_path):
    folder, printed = tmp_path / "out", tmp_path / "printed.txt"
    with cluster(tmp_path) as (scheduler, address), printed.open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "mfd_bayes", *command(campaign, folder, address)],
            stdout=file,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )
        until(lambda: "finding modes" in printed.read_text() or process.poll() is not None, "begun")
        scheduler.kill()
        _, complaint = process.communicate(timeout=60)
    assert process.returncode == 2
    (sentence,) = complaint.splitlines()
    assert sentence.startswith(f"mfd-bayes: the scheduler at {address} was lost")
    assert "--resume" in sentence
    assert not list(folder.glob(".*"))
    options = RunOptions(effort="quick", jobs=1, resume=True)
    calibrate(plan_campaign(campaign, options), folder, lambda _: None)
    assert stored(folder) == stored(whole)


# --- refusals


def test_a_scheduler_that_does_not_answer_is_refused_at_once(campaign, tmp_path):
    for address in ("tcp://127.0.0.1:9", "tcp://127.0.0.1:87867"):
        began = time.monotonic()
        assert address in refusal(*command(campaign, tmp_path / "out", address))
        assert time.monotonic() - began < 60.0
        assert not (tmp_path / "out").exists()
