"""Many jobs on any executor, each result kept as soon as it is there.

A job may start from the result of another, so the jobs form a tree: whichever finishes first, every
job starts from the same place, and a study gives the same result on any number of processes, and
after an interruption. Each result is a file of its own, written whole or not at all.
"""

import logging
import math
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent import futures
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from casid.errors import DataWarning
from casid.folder import check_folder
from casid.jobs.store import Done, Store
from casid.jobs.workers import OtherExecutor, OwnProcesses, Workers
from casid.threads import alone, cores
from casid.values import decode, encode

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
    """One job of a campaign."""

    name: str  # different from all others
    key: str  # digest of all its result depends on; else a kept result is not taken
    payload: Any  # what the work is given; it must survive pickling
    after: tuple[str, ...] = ()  # jobs to start from: the first that has a result
    alone: bool = True  # whether it is worth doing where none of these has one


@dataclass(frozen=True, kw_only=True)
class CampaignProgress:
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Execution:
    """Where many fits run, where their results are kept, and who is told.

    Parameters
    ----------
    folder : path
        Where each result is kept as soon as it is there; interrupted work goes on from there.
    executor : Executor
        Any of ``concurrent.futures``, or Dask's ``Client.get_executor()``. Unless given, up to four
        fits run in this process and more of them in one process per processor.
    progress : callable
        Called with a `CampaignProgress` after every fit; the "casid" logger tells the same.
    """

    folder: str | Path | None = None
    executor: futures.Executor | None = None
    progress: Callable[[CampaignProgress], None] | None = None


def run_jobs(
    work: Callable[[Any, Any], Any],
    jobs: Sequence[Job],
    execution: Execution = Execution(),
    *,
    also: Sequence[type] = (),
    here: bool = False,
) -> dict[str, Done]:
    """Do all jobs in turn, each after those it starts from; one that fails leaves its reason.

    ``work(payload, start)``, a function of a module so that other processes find it, gets the
    encoded result the job starts from, or None. Results may hold the classes ``also``, beside
    casid's own. With ``here`` and no executor all stay in this process. Of a KeyboardInterrupt, the
    user's, what is finished is kept. ValueError: nothing can be kept in the folder.
    """
    campaign = _Campaign(work, jobs, execution, Store(execution.folder, also))
    missing = len(jobs) - len(campaign.done)
    if missing and execution.folder is not None:
        check_folder(execution.folder)
    if missing and execution.executor is not None:
        campaign.run(OtherExecutor(execution.executor))
    elif missing and (here or len(jobs) <= FEW):
        campaign.run(Workers())
    elif missing:
        with OwnProcesses(min(cores(), missing)) as pool:
            campaign.run(pool)
    return {job.name: campaign.done[job.name] for job in jobs}


class _Campaign:
    """Submits jobs whose turn it is, writes down what comes back."""

    def __init__(
        self, work: Callable[..., Any], jobs: Sequence[Job], execution: Execution, store: Store
    ) -> None:
        self.work, self.jobs, self.store = work, jobs, store
        self.progress = execution.progress
        kept = {job.name: store.get(job.name, job.key) for job in jobs}
        self.done = {name: done for name, done in kept.items() if done is not None}
        self.kept = len(self.done)
        self.begin = time.perf_counter()
        self.attempts: dict[str, int] = {}

    def run(self, workers: Workers) -> None:
        """Until every job is done."""
        running: dict[futures.Future[Done], Job] = {}
        while True:
            self._give_up()
            flying = {job.name for job in running.values()}
            # A job that may have killed its process is tried alone.
            slots = 1 if any(name not in self.done for name in self.attempts) else workers.slots
            ready = self._ready(flying)[: max(slots - len(running), 0)]
            single = len(ready) == 1 and not running
            for job in ready:
                start = self._start(job)
                running[workers.submit(_attempt, self.work, job, *start, single)] = job
            if not running:
                return
            finished, _ = futures.wait(running, return_when=futures.FIRST_COMPLETED)
            broken = [each for each in finished if isinstance(_error(each), futures.BrokenExecutor)]
            for future in finished.difference(broken):
                self._finish(running.pop(future), self._outcome(future), keep=not _error(future))
            if broken:
                self._died(running, workers)

    def _give_up(self) -> None:
        """Leave out jobs that are nothing without those they start from, if these failed."""
        for job in self.jobs:
            if job.alone or job.name in self.done or not self.done.keys() >= set(job.after):
                continue
            if all(self.done[name].reason for name in job.after):
                said = f"not tried, as {', '.join(job.after)} failed"
                self._finish(job, Done(result=None, reason=said), keep=False)

    def _ready(self, flying: set[str]) -> list[Job]:
        ready = [
            job
            for job in self.jobs
            if job.name not in self.done
            and job.name not in flying
            and all(name in self.done for name in job.after)
        ]
        # Last of all should be what takes little (R. Graham, SIAM J. Appl. Math. 17, 1969): as long
        # as those they start from, for all that is known.
        return sorted(ready, key=lambda job: (job.name not in self.attempts, -self._before(job)))

    def _before(self, job: Job) -> float:
        """Seconds that the jobs took which this one starts from; what starts from none leads."""
        return sum(self.done[name].seconds for name in job.after) if job.after else math.inf

    def _start(self, job: Job) -> tuple[Any, str]:
        for name in job.after:
            if not self.done[name].reason:
                return encode(self.done[name].result), name
        return None, ""

    def _outcome(self, future: "futures.Future[Done]") -> Done:
        error = _error(future)
        if isinstance(error, KeyboardInterrupt):  # in a process of the user's executor
            raise error
        if error is not None:
            return Done(result=None, reason=f"{type(error).__name__}: {error}")
        done = future.result()
        return replace(done, result=decode(done.result, self.store.also))

    def _died(self, running: dict[futures.Future[Done], Job], workers: Workers) -> None:
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
            self.store.put(job.name, job.key, done)
        elapsed = time.perf_counter() - self.begin
        left, fresh = len(self.jobs) - len(self.done), len(self.done) - self.kept
        advance = CampaignProgress(
            name=job.name,
            done=len(self.done),
            total=len(self.jobs),
            seconds=done.seconds,
            failed=sum(1 for each in self.done.values() if each.reason),
            elapsed=elapsed,
            remaining=elapsed / fresh * left,
        )
        LOG.info("%s%s", advance, f"; failed: {done.reason}" if done.reason else "")
        if self.progress is not None:
            self.progress(advance)


def _attempt(
    work: Callable[[Any, Any], Any],
    job: Job,
    start: Any,  # noqa: ANN401
    source: str,
    single: bool,
) -> Done:
    """Do one job where it is sent; a failure is a result too. The result travels encoded."""
    begin = time.perf_counter()
    result, reason = None, ""
    with warnings.catch_warnings(record=True) as caught, alone(single):
        warnings.simplefilter("always", DataWarning)
        try:
            result = work(job.payload, start)
        except UnfinishedError as error:
            result, reason = error.result, str(error)
        except Exception as error:  # noqa: BLE001 - the reason stands in the table
            reason = f"{type(error).__name__}: {error}"
    told = (each.message for each in caught if issubclass(each.category, DataWarning))
    said = tuple(dict.fromkeys(map(str, told)))
    seconds = time.perf_counter() - begin
    result = encode(result)
    return Done(result=result, reason=reason, seconds=seconds, warnings=said, source=source)


def _error(future: "futures.Future[Done]") -> BaseException | None:
    """Why a job did not come back: a lost process, a payload too large; not its own failure."""
    return futures.CancelledError("cancelled") if future.cancelled() else future.exception()


def _clock(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
