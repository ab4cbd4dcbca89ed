"""The tests that are out on a cluster, followed and gathered by this machine."""

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

LOOK = 0.5
"""Seconds after which the scheduler is looked for where nothing is heard."""


def check_cluster(address: str) -> None:
    """Refuse a scheduler that does not answer, or has a worker of other versions.

    Raises
    ------
    FitError
    """
    with connected(address) as client, losses(address):
        for worker, answer in client.run(differences, versions(), on_error="return").items():
            if isinstance(answer, OSError):  # it was lost while it was asked; `work` asks again
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
    """Outcomes of tests as they come from the workers of a scheduler.

    What is outstanding at the end, however it comes, is cancelled. A test whose worker is lost
    begins again from its seed on another, as often as the scheduler allows.

    Parameters
    ----------
    jobs : sequence of Job
    out : Path
        Run folder, of this machine.
    address : str
        Such as "tcp://host:8786".
    observe : callable

    Raises
    ------
    StoreError
        When what came of a test cannot be written.
    FitError
        When the scheduler is lost, or a worker is not the same as this machine.
    """
    for job in jobs:
        observe(Step(job.id, State.WAITING))
    if not jobs:
        return
    with connected(address) as client:
        crew = _Crew(client, address, out, observe)
        try:
            crew.submit(jobs)
            while crew.places:
                outcome = crew.hear()
                if outcome is not None:
                    yield outcome
        finally:
            crew.dismiss()


@dataclass(eq=False)
class _Place:
    """A test on the cluster, and which of the attempts at it was heard of last."""

    job: Job
    future: Any
    worker: str = ""
    attempts: list[str] = field(default_factory=list)


@dataclass(eq=False)
class _Crew:
    """The tests that are outstanding, by their keys, and what comes in of them."""

    client: Any
    address: str
    out: Path
    observe: Observe
    places: dict[str, _Place] = field(default_factory=dict)
    news: queue.SimpleQueue[Any] = field(default_factory=queue.SimpleQueue)
    topic: str = field(default_factory=lambda: f"mfd_bayes-{uuid.uuid4().hex}")
    lonely: bool = False

    def submit(self, jobs: Sequence[Job]) -> None:
        """Send out all tests, with the files of the run folder that they need, each file once."""
        with losses(self.address):
            self.client.subscribe_topic(self.topic, lambda event: self.news.put(event[1]))
            names = list(dict.fromkeys(name for job in jobs for name in job.needs(self.out)))
            files = {  # as tasks, and not scattered: what a lost worker had can be had again
                name: self.client.submit(
                    _same, (self.out / name).read_bytes(), key=f"{self.topic}-file-{i}"
                )
                for i, name in enumerate(names)
            }
            for i, job in enumerate(jobs):
                given = {name: files[name] for name in job.needs(self.out)}
                key = f"{self.topic}-{i}"
                try:
                    future = self.client.submit(work, job, given, versions(), self.topic, key=key)
                except TypeError as error:
                    raise FitError(
                        f"cannot send {job.id} to the workers: {error.args[0]}"
                    ) from error
                future.add_done_callback(self.news.put)
                self.places[key] = _Place(job, future)
        self._look_for_workers()

    def hear(self) -> Outcome | None:
        """Take in what is said next; how a test ended, if it did."""
        try:
            news = self.news.get(timeout=LOOK)
        except queue.Empty:
            if self.client.status != "running":
                raise lost(self.address) from None
            self._look_for_workers()
            return None
        if self.lonely:
            self.lonely = False
            self.observe(Step("cluster", State.DONE))
        if isinstance(news, Future):
            return self._take(self.places.pop(news.key))
        self._follow(news)
        return None

    def dismiss(self) -> None:
        """Cancel what is outstanding."""
        with suppress(*FAULTS):
            self.client.cancel([place.future for place in self.places.values()])

    def _look_for_workers(self) -> None:
        """Say, once, that there is no worker, or none any longer."""
        with losses(self.address):
            lonely = not self.client.nthreads()
        if lonely and not self.lonely:
            self.lonely = True
            start = f"start one with: dask worker {self.address}"
            self.observe(Step("cluster", "waits for a worker:", message=start))

    def _follow(self, news: Mapping[str, Any]) -> None:
        """Pass on where a test stands, as its last attempt says."""
        place = self.places.get(news["key"])
        if place is None or news["attempt"] in place.attempts[:-1]:
            return
        if news["attempt"] not in place.attempts:
            if place.attempts:
                lost = f"its worker {place.worker} was lost"
                self.observe(Step(place.job.id, State.RESTARTED, message=lost))
            place.attempts.append(news["attempt"])
            place.worker = news["worker"]
        self.observe(_step(place.job.id, news["step"]))

    def _take(self, place: _Place) -> Outcome:
        """Store what came of a test."""
        job, future = place.job, place.future
        if future.status == "cancelled":  # none of ours is, as long as this is listened to
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
    """Why a test has come to nothing."""
    if isinstance(error, KilledWorker):
        return (
            f"its workers were lost {error.allowed_failures + 1} times, the last one "
            f"{error.last_worker.address}: if memory is short, give them fewer tests at a time"
        )
    return in_a_line(error)


def _same(content: bytes) -> bytes:
    return content


def _step(name: str, sent: Sequence[Any]) -> Step:
    stage, message, figures = sent
    if figures is None:
        return Step(name, stage, None, message)
    steps, limit, *others = figures
    return Step(name, stage, Progress(int(steps), int(limit), *others), message)
