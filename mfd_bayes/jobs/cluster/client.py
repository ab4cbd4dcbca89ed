"""The client's side of a cluster: it submits jobs, follows them and stores their files."""

from __future__ import annotations

import queue
import uuid
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from distributed import Future, KilledWorker

from mfd_bayes.errors import FitError
from mfd_bayes.jobs.cluster.connection import FAULTS, connected, in_a_line, losses, lost
from mfd_bayes.jobs.cluster.worker import differences, other_versions, versions, work
from mfd_bayes.jobs.job import Job, Outcome, Progress, State, Step
from mfd_bayes.store.files import write_bytes

Observe = Callable[[Step], None]

SILENCE = 0.5
"""Seconds without a message after which the scheduler and its workers are looked for."""


def check_cluster(address: str) -> None:
    """Refuse a scheduler that does not answer, or has a worker of other versions.

    Raises
    ------
    FitError
    """
    with connected(address) as client, losses(address):
        for worker, answer in client.run(differences, versions(), on_error="return").items():
            if isinstance(answer, OSError):  # the worker was lost meanwhile; `work` checks again
                continue
            if isinstance(answer, BaseException):
                raise FitError(
                    f"the worker {worker} cannot run mfd_bayes: {in_a_line(answer)}; install the "
                    "version there that is here"
                )
            if answer:
                raise FitError(other_versions(worker, answer))


def run_on_cluster(
    jobs: Sequence[Job], out: Path, address: str, observe: Observe
) -> Generator[Outcome, None, None]:
    """Outcomes of jobs in the order in which the workers of a scheduler end them.

    Jobs that have not ended when this ends, in whatever way, are cancelled. A job whose worker is
    lost begins again on another one from the same seed, as often as the scheduler allows.

    Raises
    ------
    StoreError
        When the files of a job cannot be written.
    FitError
        When the scheduler is lost, or a worker is not the same as this machine.
    """
    for job in jobs:
        observe(Step(job.id, State.WAITING))
    if not jobs:
        return
    with connected(address) as client:
        cluster = _Cluster(client, address, out, observe)
        try:
            cluster.submit(jobs)
            while cluster.submitted:
                outcome = cluster.receive()
                if outcome is not None:
                    yield outcome
        finally:
            cluster.cancel()


@dataclass(eq=False)
class _Submitted:
    """A job on the cluster, and its attempts; only messages of the last attempt count."""

    job: Job
    future: Any
    worker: str = ""
    attempts: list[str] = field(default_factory=list)


@dataclass(eq=False)
class _Cluster:
    """The submitted jobs that have not ended, by key, and the messages about them."""

    client: Any
    address: str
    out: Path
    observe: Observe
    submitted: dict[str, _Submitted] = field(default_factory=dict)
    messages: queue.SimpleQueue[Any] = field(default_factory=queue.SimpleQueue)
    topic: str = field(default_factory=lambda: f"mfd_bayes-{uuid.uuid4().hex}")
    without_workers: bool = False

    def submit(self, jobs: Sequence[Job]) -> None:
        """Submit all jobs, with the files that they need; each file is sent once."""
        with losses(self.address):
            self.client.subscribe_topic(self.topic, lambda event: self.messages.put(event[1]))
            files = self._submit_files(jobs)
            for i, job in enumerate(jobs):
                given = {name: files[name] for name in job.needs(self.out)}
                key = f"{self.topic}-{i}"
                try:
                    future = self.client.submit(work, job, given, versions(), self.topic, key=key)
                except TypeError as error:
                    raise FitError(
                        f"cannot send {job.id} to the workers: {error.args[0]}"
                    ) from error
                future.add_done_callback(self.messages.put)
                self.submitted[key] = _Submitted(job, future)
        self._look_for_workers()

    def _submit_files(self, jobs: Sequence[Job]) -> dict[str, Any]:
        """Future of each file that a job needs; dask sends it again where a worker is lost."""
        names = dict.fromkeys(name for job in jobs for name in job.needs(self.out))
        return {
            name: self.client.submit(
                _same, (self.out / name).read_bytes(), key=f"{self.topic}-file-{i}"
            )
            for i, name in enumerate(names)
        }

    def receive(self) -> Outcome | None:
        """Take in the next message; the outcome of a job where it ended one."""
        try:
            message = self.messages.get(timeout=SILENCE)
        except queue.Empty:
            if self.client.status != "running":
                raise lost(self.address) from None
            self._look_for_workers()
            return None
        if self.without_workers:
            self.without_workers = False
            self.observe(Step("cluster", State.DONE))
        if isinstance(message, Future):
            return self._store(self.submitted.pop(message.key))
        self._follow(message)
        return None

    def cancel(self) -> None:
        """Cancel the jobs that have not ended."""
        with suppress(*FAULTS):
            self.client.cancel([job.future for job in self.submitted.values()])

    def _look_for_workers(self) -> None:
        """Say, once, that the scheduler has no worker."""
        with losses(self.address):
            missing = not self.client.nthreads()
        if missing and not self.without_workers:
            self.without_workers = True
            start = f"start one with: dask worker {self.address}"
            self.observe(Step("cluster", "waits for a worker:", message=start))

    def _follow(self, message: Mapping[str, Any]) -> None:
        """Pass on a step of a job, unless it is of an attempt that was lost."""
        submitted = self.submitted.get(message["key"])
        if submitted is None or message["attempt"] in submitted.attempts[:-1]:
            return
        if message["attempt"] not in submitted.attempts:
            if submitted.attempts:
                lost = f"its worker {submitted.worker} was lost"
                self.observe(Step(submitted.job.id, State.RESTARTED, message=lost))
            submitted.attempts.append(message["attempt"])
            submitted.worker = message["worker"]
        self.observe(_step(submitted.job.id, message["step"]))

    def _store(self, submitted: _Submitted) -> Outcome:
        """Store the files of a job that has ended; its outcome."""
        job, future = submitted.job, submitted.future
        if future.status == "cancelled":  # not by us, or it would not be waited for
            raise lost(self.address)
        with losses(self.address):
            error = future.exception()
            answer = None if error else future.result()
        future.release()
        if answer is None:
            return self._fail(job, _reason(error))
        if answer["refused"]:
            raise FitError(answer["refused"])
        if set(answer["files"]) - set(job.makes):
            return self._fail(job, "its worker sent files that are not this test's")
        for name, content in answer["files"].items():
            write_bytes(self.out / name, content)
        for step in answer["steps"]:
            self.observe(_step(job.id, step))
        return Outcome(job.id, State(answer["status"]), answer["seconds"], answer["error"])

    def _fail(self, job: Job, sentence: str) -> Outcome:
        self.observe(Step(job.id, State.FAILED, message=sentence))
        return Outcome(job.id, State.FAILED, 0.0, sentence)


def _reason(error: BaseException) -> str:
    """Why a job failed."""
    if isinstance(error, KilledWorker):
        return (
            f"its workers were lost {error.allowed_failures + 1} times, the last one "
            f"{error.last_worker.address}: if memory is short, give them fewer tests at a time"
        )
    return in_a_line(error)


def _same(content: bytes) -> bytes:
    return content


def _step(name: str, sent: Sequence[Any]) -> Step:
    """Step from the plain values that a worker sends."""
    stage, message, figures = sent
    if figures is None:
        return Step(name, stage, None, message)
    steps, limit, *others = figures
    return Step(name, stage, Progress(int(steps), int(limit), *others), message)
