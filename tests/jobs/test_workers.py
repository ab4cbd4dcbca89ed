"""Processes that do jobs: what they leave alone, and what is said where one of them fails."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass

import pytest

from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.jobs.dispatch import Workplace
from mfd_bayes.jobs.job import Outcome, State, Step
from mfd_bayes.jobs.processes import context, started_alike
from mfd_bayes.jobs.workers import run_in_processes

ERRORS = {
    "disk": OSError(28, "No space left on device", "/tmp/block.npz"),
    "memory": MemoryError("Unable to allocate 3 GiB"),
}


@dataclass(frozen=True)
class Work:
    """A job that writes nothing, or fails."""

    id: str
    makes: tuple[str, ...] = ()

    def needs(self, out):
        return ()

    def run(self, out, observe):
        observe(Step(self.id, "at work"))
        if self.id in ERRORS:
            raise ERRORS[self.id]
        return Outcome(self.id, State.DONE, 0.0)


def work(*names, out, processes=1):
    return list(run_in_processes([Work(n) for n in names], out, processes, lambda _: None))


def test_processes_of_the_caller_live_on(tmp_path):
    with started_alike(), ProcessPoolExecutor(1, context()) as pool:
        theirs = pool.submit(os.getpid).result()
        assert [outcome.status for outcome in work("a", out=tmp_path)] == ["done"]
        assert [child.pid for child in multiprocessing.active_children()] == [theirs]
        assert pool.submit(os.getpid).result() == theirs


def test_no_process_of_the_jobs_lives_on(tmp_path):
    jobs = [Work("a"), Work("b"), Work("c")]
    with closing(run_in_processes(jobs, tmp_path, 2, lambda _: None)) as outcomes:
        next(outcomes)
        assert multiprocessing.active_children()
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    ("name", "kind", "said"),
    [
        ("disk", StoreError, "cannot store disk in /tmp/block.npz: No space left on device"),
        (
            "memory",
            FitError,
            r"memory is too short for memory \(Unable to allocate 3 GiB\): give fewer --jobs",
        ),
    ],
)
def test_a_full_disk_or_memory_is_said_in_a_sentence(tmp_path, capfd, name, kind, said):
    with pytest.raises(kind, match=said):
        work(name, out=tmp_path)
    assert capfd.readouterr().err == ""


def test_as_many_processes_as_this_process_may_use(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 6}, raising=False)
    assert Workplace().processes == 3
    assert Workplace(jobs=7).processes == 7
    monkeypatch.delattr(os, "sched_getaffinity")  # as on a Mac
    assert Workplace().processes == 64
