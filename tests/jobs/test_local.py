"""Jobs in processes of this machine: losses, full disks, and how the processes start and end."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.jobs.job import JobState, Outcome, Step
from mfd_bayes.jobs.local import (
    context,
    run_in_processes,
    several_processes,
    started_alike,
)

ERRORS = {
    "disk": OSError(28, "No space left on device", "/tmp/block.npz"),
    "memory": MemoryError("Unable to allocate 3 GiB"),
}


@dataclass(frozen=True)
class Work:
    """A job that writes nothing, fails, or is killed `kills` times."""

    id: str
    kills: int = 0
    makes: tuple[str, ...] = ()

    def needs(self, out):
        return ()

    def run(self, out, observe):
        observe(Step(self.id, "at work"))
        if self.id in ERRORS:
            raise ERRORS[self.id]
        killed = len(list(out.iterdir()))
        if killed < self.kills:
            (out / str(killed)).touch()
            time.sleep(0.3)  # its step is seen
            os.kill(os.getpid(), signal.SIGKILL)
        return Outcome(self.id, JobState.DONE, 0.0)


def work(*jobs, folder, processes=1, observe=lambda _: None):
    return list(run_in_processes(jobs, folder, processes, observe))


def test_a_killed_process_is_said_in_one_sentence_and_its_job_begins_again(tmp_path):
    events = []
    outcomes = work(Work("a", kills=2), Work("b"), folder=tmp_path, observe=events.append)
    assert sorted(o.id for o in outcomes) == ["a", "b"]
    assert {o.status for o in outcomes} == {"done"}
    notes = [step.message for step in events if step.stage == "note:"]
    assert len(notes) == 2
    assert all("killed" in note and note.endswith(": a") for note in notes)


def test_processes_of_the_caller_live_on_and_those_of_the_jobs_do_not(tmp_path):
    with started_alike(), ProcessPoolExecutor(1, context()) as pool:
        theirs = pool.submit(os.getpid).result()
        jobs = [Work("a"), Work("b"), Work("c")]
        with closing(run_in_processes(jobs, tmp_path, 2, lambda _: None)) as outcomes:
            assert next(outcomes).status == "done"
        assert [child.pid for child in multiprocessing.active_children()] == [theirs]


def test_a_full_disk_or_memory_is_said_in_a_sentence(tmp_path, capfd):
    for name, kind, sentence in [
        ("disk", StoreError, "cannot store disk in /tmp/block.npz: No space left on device"),
        ("memory", FitError, r"memory is too short for memory \(Unable to .*\): give fewer --jobs"),
    ]:
        with pytest.raises(kind, match=sentence):
            work(Work(name), folder=tmp_path)
        assert capfd.readouterr().err == ""


# --- the server that processes are forked from

POOL = """
import sys, time
from concurrent.futures import ProcessPoolExecutor
from mfd_bayes.jobs.local import context, get_ready, started_alike
from mfd_bayes.jobs.signals import end_on_signals
if __name__ == "__main__":
    get_ready("colorsys")
    with end_on_signals(), started_alike(), ProcessPoolExecutor(1, context()) as pool:
        there = pool.submit(eval, "'colorsys' in __import__('sys').modules").result()
        print(there, "colorsys" in sys.modules, context().get_start_method(), flush=True)
        time.sleep(60)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has the server here")
def test_a_signal_ends_a_pool_that_has_imported_ahead_with_one_sentence(tmp_path):
    (tmp_path / "pool.py").write_text(POOL)
    process = subprocess.Popen(
        [sys.executable, tmp_path / "pool.py"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        start_new_session=True,
    )
    # the pool has imported the module; its parent has not
    assert process.stdout.readline().split() == ["True", "False", "forkserver"]
    process.send_signal(signal.SIGTERM)
    assert process.communicate(timeout=60)[1] == "mfd-bayes: interrupted by SIGTERM\n"
    assert process.returncode == 143


# --- functions that several processes compute

RNG, TESTS = np.random.default_rng(1), 9
POINTS = [(j, RNG.standard_normal((5, 3))) for j in [*range(TESTS), 3, 3, 0]]


@pytest.fixture
def functions():
    """Linear functions, which can be pickled without this file."""
    return [partial(np.dot, b=np.array([1.0, j, -2.0])) for j in range(TESTS)]


def not_here(x):
    raise AssertionError("computed by the process that gathers")


def test_values_are_those_of_one_process_in_the_same_order(functions):
    expected = [functions[j](x) for j, x in POINTS]
    with several_processes(functions, 2) as evaluate:
        functions[:] = [not_here] * TESTS
        for _ in range(2):
            np.testing.assert_array_equal(list(evaluate(iter(POINTS))), expected)
        assert multiprocessing.active_children()  # the second starts where the first is busy
        with pytest.raises(ValueError, match="shapes"):
            list(evaluate([(0, np.zeros((5, 2)))]))
    assert not multiprocessing.active_children()


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_where_a_process_is_killed_this_one_goes_on(functions):
    expected = [functions[j](x) for j, x in POINTS]
    with several_processes(functions, 2) as evaluate:
        stream = evaluate(iter(POINTS))
        head = next(stream)
        os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)
        np.testing.assert_array_equal([head, *stream], expected)
        np.testing.assert_array_equal(list(evaluate(POINTS)), expected)
