"""Many jobs on any executor, each result kept as soon as it is there.

A job may start from the result of another, so the jobs form a tree: whoever finishes first, every
job starts from the same place, and a study gives the same result on any number of processes, and
after an interruption. Each result is a file of its own, written whole or not at all.
"""

import hashlib
import logging
import re
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from casid.errors import DataWarning
from casid.files import read_json, write_json
from casid.jobs.workers import Borrowed, Here, Own, Workers, processors

LOG = logging.getLogger("casid")

FEW = 4  # jobs that are not worth starting processes for
ATTEMPTS = 2  # of a job whose process dies


class UnfinishedError(RuntimeError):
    """A job failed, but has something to show; ``result`` is not taken as a start of others."""

    def __init__(self, message: str, result: Any = None) -> None:  # noqa: ANN401 - any result
        super().__init__(message)
        self.result = result


@dataclass(frozen=True, eq=False, kw_only=True)
class Job:
    """One job of a campaign.

    Parameters
    ----------
    name : str
        Different from all others.
    key : str
        Digest of all its result depends on; a kept result of another key is not taken.
    payload
        What the work is given; it must survive pickling.
    after : tuple of str
        Jobs to start from, the nearest first: the first that has a result is taken.
    """

    name: str
    key: str
    payload: Any
    after: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Done:
    """What became of a job; ``reason`` says why it failed, and is empty if it did not."""

    result: Any
    reason: str = ""
    seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    kept: bool = False
    source: str = ""


@dataclass(frozen=True, kw_only=True)
class Advance:
    """How far a campaign is; ``remaining`` [s] is expected from the pace so far."""

    name: str
    done: int
    total: int
    failed: int
    seconds: float
    elapsed: float
    remaining: float

    @property
    def left(self) -> str:
        """``remaining`` in words."""
        return _clock(self.remaining)

    def __str__(self) -> str:
        """One line of progress."""
        failed = f", {self.failed} failed" if self.failed else ""
        left = f", {self.left} left" if self.done < self.total else ""
        return (
            f"{self.done} of {self.total}{failed}: {self.name} in {self.seconds:.1f} s, "
            f"{_clock(self.elapsed)} so far{left}"
        )


class Shelf:
    """Finished jobs of one study in one folder, a file each; without a folder none is kept.

    Results must be plain values and arrays.
    """

    def __init__(self, folder: str | Path | None) -> None:
        self.folder = None if folder is None else Path(folder)

    def path(self, name: str) -> Path:
        """File of a job."""
        short = re.sub(r"[^A-Za-z0-9.+-]+", "_", name)[:40].strip("_")
        unique = hashlib.sha256(name.encode()).hexdigest()[:8]
        return (self.folder or Path()) / f"{short}.{unique}.json"

    def get(self, name: str, key: str) -> Done | None:
        """What is kept of a job; None unless it was finished with the same key."""
        if self.folder is None or not self.path(name).exists():
            return None
        try:
            content = read_json(self.path(name))
            if content["casid"] != "job" or content["key"] != key:
                return None
            return Done(
                result=content["result"], reason=content["reason"], seconds=content["seconds"],
                warnings=tuple(content["warnings"]), source=content["source"], kept=True,
            )  # fmt: skip
        except (ValueError, TypeError, LookupError):  # another version's file: compute it again
            return None

    def put(self, name: str, key: str, done: Done) -> None:
        """Keep a finished job."""
        if self.folder is None:
            return
        content = {"casid": "job", "name": name, "key": key, "reason": done.reason,
                   "seconds": done.seconds, "warnings": list(done.warnings),
                   "source": done.source, "result": done.result}  # fmt: skip
        write_json(self.path(name), content)


def run_jobs(
    work: Callable[[Any, Any], Any],
    jobs: Sequence[Job],
    *,
    shelf: Shelf,
    executor: Executor | None = None,
    progress: Callable[[Advance], None] | None = None,
    here: bool = False,
) -> dict[str, Done]:
    """Do all jobs; one that fails leaves its reason.

    Parameters
    ----------
    work : callable
        ``work(payload, start)`` with the result the job starts from, or None; a function of a
        module, so that other processes find it.
    jobs : sequence of Job
        In the order in which to begin them; one stands after those it starts from.
    shelf : Shelf
        Where results are kept and found.
    executor : Executor
        Any of ``concurrent.futures``; without one, up to four jobs run in this process, more of
        them in one process per processor.
    progress : callable
        Called with an `Advance` after every job.
    here : bool
        Without an executor, stay in this process however many the jobs.

    Returns
    -------
    dict
        By name, in the order of the jobs.
    """
    done = {job.name: kept for job in jobs if (kept := shelf.get(job.name, job.key)) is not None}
    campaign = _Campaign(work, jobs, done, shelf, progress)
    if len(done) < len(jobs):
        if executor is not None:
            campaign.run(Borrowed(executor))
        elif here or len(jobs) <= FEW:
            campaign.run(Here())
        else:
            with Own(min(processors(), len(jobs) - len(done))) as pool:
                campaign.run(pool)
    return {job.name: campaign.done[job.name] for job in jobs}


class _Campaign:
    """Submits jobs whose turn it is, writes down what comes back."""

    def __init__(
        self,
        work: Callable[[Any, Any], Any],
        jobs: Sequence[Job],
        done: dict[str, Done],
        shelf: Shelf,
        progress: Callable[[Advance], None] | None,
    ) -> None:
        self.work, self.jobs, self.done, self.shelf = work, jobs, done, shelf
        self.progress = progress
        self.kept = len(done)
        self.begin = time.perf_counter()
        self.attempts: dict[str, int] = {}

    def run(self, workers: "Workers") -> None:
        """Until every job is done."""
        running: dict[Future[Done], Job] = {}
        while True:
            flying = {job.name for job in running.values()}
            slots = 1 if self._suspects() else workers.slots
            for job in self._ready(flying)[: max(slots - len(running), 0)]:
                running[workers.submit(_attempt, self.work, job, *self._start(job))] = job
            if not running:
                return
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            broken = [future for future in finished if isinstance(_error(future), BrokenExecutor)]
            for future in finished.difference(broken):
                self._finish(running.pop(future), _outcome(future), keep=_error(future) is None)
            if broken:
                self._died(running, workers)

    def _ready(self, flying: set[str]) -> list[Job]:
        ready = [
            job
            for job in self.jobs
            if job.name not in self.done
            and job.name not in flying
            and all(name in self.done for name in job.after)
        ]
        return sorted(ready, key=lambda job: job.name not in self.attempts)

    def _suspects(self) -> bool:
        """Whether a job may have killed its process and has not been tried alone yet."""
        return any(name not in self.done for name in self.attempts)

    def _start(self, job: Job) -> tuple[Any, str]:
        for name in job.after:
            if not self.done[name].reason:
                return self.done[name].result, name
        return None, ""

    def _died(self, running: dict[Future[Done], Job], workers: "Workers") -> None:
        """A process died; which job killed it shows when they are tried again, one at a time."""
        suspects = list(running.values())
        running.clear()
        for job in suspects:
            self.attempts[job.name] = self.attempts.get(job.name, 0) + 1
        alive = workers.renew()
        for job in suspects:
            if not alive or self.attempts[job.name] >= ATTEMPTS:
                reason = "the process it ran in died" if alive else "the executor broke down"
                self._finish(job, Done(result=None, reason=reason), keep=False)

    def _finish(self, job: Job, done: Done, *, keep: bool) -> None:
        self.done[job.name] = done
        if keep:
            self.shelf.put(job.name, job.key, done)
        elapsed = time.perf_counter() - self.begin
        left, fresh = len(self.jobs) - len(self.done), len(self.done) - self.kept
        advance = Advance(
            name=job.name, done=len(self.done), total=len(self.jobs), seconds=done.seconds,
            failed=sum(1 for each in self.done.values() if each.reason),
            elapsed=elapsed, remaining=elapsed / fresh * left,
        )  # fmt: skip
        LOG.info("%s%s", advance, f"; failed: {done.reason}" if done.reason else "")
        if self.progress is not None:
            self.progress(advance)


def _attempt(work: Callable[[Any, Any], Any], job: Job, start: Any, source: str) -> Done:  # noqa: ANN401
    """Do one job where it is sent; a failure is a result too."""
    begin = time.perf_counter()
    result, reason = None, ""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataWarning)
        try:
            result = work(job.payload, start)
        except UnfinishedError as error:
            result, reason = error.result, str(error)
        except Exception as error:  # noqa: BLE001 - the reason stands in the table
            reason = f"{type(error).__name__}: {error}"
    said = tuple(dict.fromkeys(str(each.message) for each in caught))
    seconds = time.perf_counter() - begin
    return Done(result=result, reason=reason, seconds=seconds, warnings=said, source=source)


def _error(future: "Future[Done]") -> BaseException | None:
    """What became of the sending, not of the job itself: a lost process, a payload too large."""
    return CancelledError("cancelled") if future.cancelled() else future.exception()


def _outcome(future: "Future[Done]") -> Done:
    error = _error(future)
    if error is None:
        return future.result()
    return Done(result=None, reason=f"{type(error).__name__}: {error}")


def _clock(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
