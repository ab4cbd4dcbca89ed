"""Jobs on the workers of a dask.distributed cluster, which share no files with this machine.

A worker gets a job and the files that it needs; it sends small messages of its progress, and at the
end the files that it made. Both ends must trust each other: dask.distributed unpickles what they
send.
"""

from __future__ import annotations

import json
import logging
import platform
import queue
import re
import tempfile
import time
import uuid
import warnings
from asyncio import CancelledError
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from distributed import Client, KilledWorker, as_completed, get_worker
from distributed.versions import VersionMismatchWarning
from scipy import linalg  # noqa: F401  # loads scipy's BLAS, for `refusal` to find it
from threadpoolctl import threadpool_info, threadpool_limits

from mfd_bayes.errors import FitError
from mfd_bayes.jobs.job import Job, JobState, Outcome, Progress, Step
from mfd_bayes.store.files import write_bytes

PATIENCE = 5.0  # s in which a scheduler must answer
WATCH = 0.2  # s between looks at what has ended

FAULTS = (OSError, TimeoutError, CancelledError, RuntimeError)
"""Errors that dask.distributed raises when the scheduler is lost, depending on the moment."""

_LOGS = ("distributed", "distributed.client", "tornado", "tornado.application", "asyncio")
_SAME = ("mfd_bayes", "numpy", "scipy", "emcee", "distributed")


def check_cluster(address: str) -> None:
    """Refuse a scheduler that does not answer, or has a worker of other versions."""
    with _connected(address) as client, _losses(address):
        answers = client.run(refusal, versions(), on_error="return")
    for worker, answer in answers.items():
        if isinstance(answer, OSError):  # the worker was lost meanwhile; `work` checks again
            continue
        if isinstance(answer, BaseException):
            answer = f"cannot run mfd_bayes: {_in_a_line(answer)}; install the version that is here"
        if answer:
            raise FitError(f"the worker {worker} {answer}")


def run_on_cluster(
    jobs: Sequence[Job], folder: Path, address: str, observe: Callable[[Step], None]
) -> Generator[Outcome, None, None]:
    """Outcomes of jobs in the order in which the workers of a scheduler end them.

    Jobs that have not ended when this ends, in whatever way, are cancelled. A job whose worker is
    lost begins again on another one from the same seed, as often as the scheduler allows.
    """
    for job in jobs:
        observe(Step(job.id, JobState.WAITING))
    if not jobs:
        return
    messages: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
    topic = f"mfd_bayes-{uuid.uuid4().hex}"
    attempts: dict[str, str] = {}  # the last one of each job
    idle = False
    with _connected(address) as client:
        with _losses(address):
            client.subscribe_topic(topic, lambda event: messages.put(event[1]))
            futures = _submit(client, jobs, folder, topic)
        ids = {future.key: job.id for future, job in futures.items()}
        ended = as_completed(futures, loop=client.loop, raise_errors=False)
        try:
            while not ended.is_empty():
                with _losses(address):
                    if client.status != "running":
                        raise _lost(address)
                    missing = not client.nthreads()
                if missing and not idle:
                    start = f"start one with: dask worker {address}"
                    observe(Step("cluster", "waits for a worker:", message=start))
                elif idle and not missing:
                    observe(Step("cluster", JobState.DONE))
                idle = missing
                while not messages.empty():
                    message = messages.get()
                    key, attempt = message["key"], message["attempt"]
                    if key in ids:
                        if attempts.setdefault(key, attempt) != attempt:
                            attempts[key] = attempt
                            lost = "its worker was lost"
                            observe(Step(ids[key], JobState.RESTARTED, message=lost))
                        step = json.loads(message["step"])
                        progress = step.pop("progress") or None
                        observe(Step(**step, progress=progress and Progress(**progress)))
                for future in ended.next_batch(block=False) if ended.has_ready() else ():
                    del ids[future.key]
                    yield _store(future, futures.pop(future), folder, address, observe)
                time.sleep(WATCH)
        finally:
            with suppress(*FAULTS):
                client.cancel(list(futures))


def _submit(client: Any, jobs: Sequence[Job], folder: Path, topic: str) -> dict[Any, Job]:
    """Future of each job; each file that jobs need is sent once.

    A file is a task of its own, and not scattered: dask makes it again where a worker is lost.
    """
    names = dict.fromkeys(name for job in jobs for name in job.needs(folder))
    files = {
        name: client.submit(bytes, (folder / name).read_bytes(), key=f"{topic}-file-{i}")
        for i, name in enumerate(names)
    }
    futures = {}
    for i, job in enumerate(jobs):
        inputs = {name: files[name] for name in job.needs(folder)}
        try:
            future = client.submit(work, job, inputs, versions(), topic, key=f"{topic}-{i}")
        except TypeError as error:
            raise FitError(f"cannot send {job.id} to the workers: {error.args[0]}") from error
        futures[future] = job
    return futures


def _store(
    future: Any, job: Job, folder: Path, address: str, observe: Callable[[Step], None]
) -> Outcome:
    """Store the files of a job that has ended; its outcome."""
    if future.status in ("cancelled", "lost"):  # not by us, or it would not be waited for
        raise _lost(address)
    with _losses(address):
        error = future.exception()
        answer = None if error else future.result()
    if isinstance(error, FitError):  # it was refused
        raise error
    if answer is None:
        reason = _in_a_line(error)
        if isinstance(error, KilledWorker):
            reason = (
                f"its workers were lost {error.allowed_failures + 1} times, the last one "
                f"{error.last_worker.address}: if memory is short, give them fewer tests at a time"
            )
        observe(Step(job.id, JobState.FAILED, message=reason))
        return Outcome(job.id, JobState.FAILED, 0.0, reason)
    outcome, files, steps = answer
    for name in job.makes:  # and no other file
        if name in files:
            write_bytes(folder / name, files[name])
    for step in steps:
        observe(step)
    return outcome  # type: ignore[no-any-return]


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Connection to a scheduler, without the library's own log messages."""
    if not re.fullmatch(r"(tcp|tls)://.+:\d+", address):
        raise FitError(f"--scheduler must be like tcp://host:8786, got {address!r}")
    levels = {name: logging.getLogger(name).level for name in _LOGS}
    for name in _LOGS:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", VersionMismatchWarning)  # `refusal` reports it
                client = Client(address, timeout=PATIENCE, name="mfd-bayes", set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise FitError(
                f"no scheduler answers at {address} ({_in_a_line(error)}); start one: dask "
                "scheduler"
            ) from error
        try:
            yield client
        finally:
            with suppress(*FAULTS):
                client.close(timeout=PATIENCE)
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


@contextmanager
def _losses(address: str) -> Iterator[None]:
    """Turn every error of a lost scheduler into a FitError."""
    try:
        yield
    except FAULTS as error:
        raise _lost(address) from error


def _lost(address: str) -> FitError:
    return FitError(
        f"the scheduler at {address} was lost: what is finished is kept; go on with --resume, "
        "with a scheduler or without"
    )


def _in_a_line(error: BaseException) -> str:
    """Message of an error in one line, with the kind of the error unless it is an OSError."""
    text = " ".join(str(error).split()) or "no reason given"
    return text if isinstance(error, OSError) else f"{type(error).__name__}: {text}"


# --- on a worker


def work(
    job: Job, inputs: Mapping[str, bytes], expected: Mapping[str, str], topic: str
) -> tuple[Outcome, dict[str, bytes], list[Step]]:
    """Do a job in a temporary folder; its outcome, the files that it made and its last steps.

    A worker that would compute other draws refuses by a FitError.
    """
    worker = get_worker()
    if refused := refusal(expected):
        raise FitError(f"the worker {worker.address} {refused}")
    key, attempt = worker.get_current_task(), uuid.uuid4().hex
    final_steps: list[Step] = []

    def send(step: Step) -> None:
        if step.stage in (
            JobState.DONE,
            JobState.FAILED,
        ):  # returned: so it comes after all messages
            final_steps.append(step)
            return
        task = worker.state.tasks.get(key)
        if task is None or task.state == "cancelled":
            raise RuntimeError("cancelled")
        text = json.dumps(asdict(step), default=float)
        worker.log_event(topic, {"key": key, "attempt": attempt, "step": text})

    with tempfile.TemporaryDirectory(prefix="mfd_bayes-") as folder:
        root = Path(folder)
        for name, content in inputs.items():
            write_bytes(root / name, content)
        outcome = job.run(root, send)
        outputs = [name for name in job.makes if (root / name).is_file()]
        return outcome, {name: (root / name).read_bytes() for name in outputs}, final_steps


def versions() -> dict[str, str]:
    """Versions that must be the same on both sides for the draws to be the same."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python} | {name: version(name) for name in _SAME}


def refusal(expected: Mapping[str, str]) -> str:
    """Why this process would compute other draws: other versions, or several threads; else "".

    The number of threads changes the last bits of sums. It is set to one, and not set back: other
    jobs may run in other threads of this process.
    """
    installed = versions()
    differences = [
        f"{name} {installed.get(name, 'of no version')} and not {required}"
        for name, required in expected.items()
        if installed.get(name) != required
    ]
    if differences:
        return f"has {', '.join(differences)} as here: install the same versions there"
    threadpool_limits(limits=1)
    threaded = sorted(pool["filepath"] for pool in threadpool_info() if pool["num_threads"] != 1)
    if not threaded:
        return ""
    return (
        f"computes with several threads, and {', '.join(threaded)} cannot be told not to: start it "
        "with OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1"
    )
