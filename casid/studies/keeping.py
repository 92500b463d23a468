"""What runs the stages of a study: results that still hold are taken, new ones kept, both told."""

import logging
import sys
import time
import warnings
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import partial
from importlib import import_module
from logging.handlers import BufferingHandler
from shutil import rmtree
from typing import Any, TypeAlias, TypeVar

from casid.bounds.pooled_warnings import kind
from casid.errors import ConvergenceError, DataWarning, warn
from casid.fit import Fit
from casid.jobs.campaigns import CampaignProgress, Execution
from casid.jobs.child_process import beside
from casid.jobs.digests import equations_digest, own_source, source_digest, structure_digest
from casid.jobs.store import Done, Store
from casid.nlp import Progress
from casid.report.content import Timing
from casid.slow_sources import repeats_known
from casid.stages.stage import LeftOutError, Stage, Task, compute, watched
from casid.studies.study import Study
from casid.threads import cores
from casid.values import digest

T = TypeVar("T")
LOG = logging.getLogger("casid")
STALE = (
    "The {does} in the folder of results is of an earlier state of the study and is not shown; "
    "casid {command} makes it anew."
)


class Watch:
    """Who is told how a study goes on; this one is told in vain."""

    def begin(self, stage: str) -> None:
        """Note that a stage begins."""

    def progress(self, progress: Progress) -> None:
        """Note an iteration within a stage."""

    def end(self, timing: Timing) -> None:
        """Note that a stage has ended."""


class Keeper:
    """Runs the stages of one study and keeps what they find in its folder.

    The watch is told of every stage, the clock's timings are those of what was done before, to
    which these are added; with ``fresh`` every stage is computed again. What other commands' stages
    found earlier is shown while it holds.
    """

    def __init__(
        self, study: Study, watch: Watch, clock: list[Timing], *, fresh: bool, command: str
    ) -> None:
        self._study, self._fresh, self._command = study, fresh, command
        self._watch, self.clock = watch, clock
        self.warnings: list[str] = []
        self._store = Store(study.output / "stages", (type(study.model),))
        self._keys: dict[str, str] = {}
        self.processes = ExitStack()  # beside this one
        self._begun: dict[str, Callable[[], _Apart] | None] = {}  # there; None of what is kept
        self._source = source_digest()
        self._structure = [structure_digest(study.model_file), equations_digest(study.model)]

    def __call__(self, stage: Stage, settings: Any, task: Task) -> Any:  # noqa: ANN401 - of any stage
        """Return the kept result of a stage, or compute and keep it."""
        if stage.command:
            return self._asked(stage, settings, task)
        if not stage.kept:
            done = self._done(stage, settings, task)
            for said in done.warnings:
                warn(said)
            self.warnings += done.warnings
            self._note(stage.name, done.seconds, done.result)
            return done.result
        key = self._keys[stage.name] = self._key(stage, settings, task)
        kept = None if self._fresh else self._store.get(stage.name, key)
        if kept is None:
            return self._computed(stage, settings, task, key)
        self._drop_best(stage)
        self.warnings += self._news(kept)
        self._note(stage.name, kept.seconds, kept.result, kept=True)
        return kept.result

    def begin(self, stage: Stage, settings: Any, task: Task) -> None:  # noqa: ANN401 - of any stage
        """Begin a stage before its turn, in a process beside this one, if a processor is free."""
        if stage.name in self._begun:
            return
        if stage.kept and not self._fresh:
            key = self._key(stage, settings, task)
            if self._store.get(stage.name, key) is not None:
                self._begun[stage.name] = None
                return
        busy = sum(begun is not None for begun in self._begun.values())
        if busy < cores() > 1:
            work = partial(_apart, stage, settings, self._ready(stage, task))
            self._begun[stage.name] = self.processes.enter_context(beside(work))

    def timed(self, name: str, step: Callable[[], T]) -> T:
        """Compute a step that is not kept."""
        self._watch.begin(name)
        start = time.perf_counter()
        result = step()
        self._note(name, time.perf_counter() - start, result)
        return result

    def _computed(self, stage: Stage, settings: Any, task: Task, key: str) -> Any:  # noqa: ANN401
        try:
            done = self._done(stage, settings, task)
        except ConvergenceError as error:
            raise self._with_best(stage, error) from error
        self.warnings += self._news(done)
        self._store.put(stage.name, key, done)
        self._drop_best(stage)
        self._note(stage.name, done.seconds, done.result)
        return done.result

    def _done(self, stage: Stage, settings: Any, task: Task) -> Done:  # noqa: ANN401
        """What a stage finds, here or in the process that has begun it."""
        self._watch.begin(stage.name)
        if (begun := self._begun.pop(stage.name, None)) is None:
            own = watched(settings, self._watch.progress)
            return _made(stage, own, self._ready(stage, task))
        import_module("casid.report.html")  # needed in the end: the other process may still work
        done, logged = begun()
        for each in logged:
            LOG.handle(each)
        return done

    def _ready(self, stage: Stage, task: Task) -> Task:
        """The task with the folder in which a stage of many fits keeps each of them.

        What else than casid computes such a fit stands in the stage's key only.
        """
        if own_source(stage.run):
            return task
        folder = self._store.path(stage.name).with_suffix("")
        if self._fresh:
            rmtree(folder, ignore_errors=True)
        return replace(task, execution=Execution(folder=folder))

    def _with_best(self, stage: Stage, error: ConvergenceError) -> ConvergenceError:
        """The error, its best iterate written to a file."""
        if not isinstance(error.best, Fit):
            return error
        best = self._store.path(f"{stage.name}_best")
        error.best.save(best)
        return ConvergenceError(
            f"{error}\nThe best iterate is kept in {best} (Fit.load reads it, and its values may "
            "serve as [model.values]), and so is every stage before.",
            error.best,
        )

    def _drop_best(self, stage: Stage) -> None:
        """Delete the best iterate of an earlier failure: the stage has a result."""
        best = self._store.path(f"{stage.name}_best")
        if best.exists():
            best.unlink()

    def _asked(self, stage: Stage, settings: Any, task: Task) -> Any:  # noqa: ANN401
        """What a stage of another command found, if it still holds; if asked for, run it."""
        folder = self._study.output / stage.name

        def progress(advance: CampaignProgress) -> None:
            self._watch.end(Timing(stage=advance.name, seconds=advance.seconds))
            done = f"{advance.done} of {advance.total}, {advance.left} left"
            self._watch.begin(f"{stage.name}, {done}")

        if stage.command == self._command:
            ready = replace(task, execution=Execution(folder=folder, progress=progress))
            return self.timed(stage.name, lambda: self._heard(stage, settings, ready))
        if not folder.exists():
            raise LeftOutError
        ready = replace(task, execution=Execution(folder=folder, executor=_Idle()))
        try:
            return self._heard(stage, settings, ready)
        except LeftOutError:
            said = STALE.format(does=stage.does, command=stage.command)
            LOG.warning(said)
            self.warnings.append(said)
            raise

    def _heard(self, stage: Stage, settings: Any, task: Task) -> Any:  # noqa: ANN401
        """What a stage of other commands finds; what it warns of is for the report."""
        done = _made(stage, settings, task)
        self.warnings += self._news(done)
        return done.result

    def _news(self, done: Done) -> list[str]:
        """What of a stage's warnings no stage before has told, if with other figures."""
        before = {kind(said) for said in self.warnings}
        return [said for said in done.warnings if not any(each in kind(said) for each in before)]

    def _note(self, name: str, seconds: float, result: object, *, kept: bool = False) -> None:
        timing = Timing(stage=name, seconds=seconds, kept=kept)
        if isinstance(result, Fit):
            timing = replace(timing, iterations=result.iterations, cost=result.cost)
        self.clock.append(timing)
        self._watch.end(timing)

    def _key(self, stage: Stage, settings: Any, task: Task) -> str:  # noqa: ANN401
        """Digest of all a stage's result depends on."""
        before = [self._keys.get(name, "") for name in (*stage.needs, *stage.uses)]
        given = [settings, task.records, task.hold]
        parts: list[Any] = [self._source, own_source(stage.run), before, *given]
        if stage.structured:
            study = self._study
            parts += [self._structure, asdict(study.model), study.fixed, study.bounds]
        return digest(*parts)


_Apart: TypeAlias = tuple[Done, list[logging.LogRecord]]


def _made(stage: Stage, settings: Any, task: Task) -> Done:  # noqa: ANN401
    """What a stage finds, how long it takes and what it warns of."""
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataWarning)
        with repeats_known():  # as the records were read
            result = compute(stage, settings, task)
    said = tuple(dict.fromkeys(str(each.message) for each in caught))
    return Done(result=result, seconds=time.perf_counter() - start, warnings=said)


def _apart(stage: Stage, settings: Any, task: Task) -> _Apart:  # noqa: ANN401
    """The same in a process beside, and what it logs, to be told when it is its turn."""
    own, heard = (LOG.handlers, LOG.propagate), BufferingHandler(sys.maxsize)
    LOG.handlers, LOG.propagate = [heard], False
    try:
        return _made(stage, settings, task), heard.buffer
    finally:
        LOG.handlers, LOG.propagate = own


class Holding(Keeper):
    """Takes what is kept and still holds, and computes nothing."""

    def begin(self, stage: Stage, settings: Any, task: Task) -> None:  # noqa: ANN401
        """Begin nothing."""

    def _done(self, stage: Stage, settings: Any, task: Task) -> Done:  # noqa: ANN401
        if stage.name != "chosen":  # which is kept with the choice
            raise LeftOutError
        return super()._done(stage, settings, task)

    def _asked(self, stage: Stage, settings: Any, task: Task) -> Any:  # noqa: ANN401, ARG002
        raise LeftOutError

    def _drop_best(self, stage: Stage) -> None:
        """Nothing is deleted."""


class _Idle(Executor):
    """Refuses all work: what is kept needs none."""

    def submit(self, *_: Any, **__: Any) -> Future[Any]:  # noqa: ANN401 - of any work
        """Refuse."""
        raise LeftOutError
