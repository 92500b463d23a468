"""What a stage is, and how a list of them runs.

A stage is one value: its settings (a frozen value, which its table in a study file becomes), what
it takes from stages before it, what it computes, and the sections of the report that show it.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol, TypeAlias, get_args

from casid.checks import hint
from casid.errors import ConvergenceError
from casid.fit import Fit
from casid.jobs.campaigns import Execution
from casid.model import Bounds, Model
from casid.nlp import Progress
from casid.nonlinear.model import NonlinearModel
from casid.record import Hold, Record
from casid.records import common_units
from casid.report.content import Content, Section
from casid.validation import AnyModel

Role: TypeAlias = Literal["identification", "frequency", "refinement", "validation"]
ROLES: tuple[Role, ...] = get_args(Role)


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """What a stage works on.

    Parameters
    ----------
    model, fixed, bounds
        As in `Estimator.fit`.
    roles, records : mapping, tuple of Record
        Records by role, and those of the stage's own role.
    checks : mapping
        The same records by role with the study's check channels, behind the outputs; {} without.
    results, models : mapping
        What stages before this one found, by name, and those that simulate, by their stage's label.
    stages, settings
        All of the study's, for a stage that repeats others.
    hold : str
        What is stated of the inputs between samples, if anything is.
    execution : Execution
        Where a stage of many fits runs them, and in which folder each is kept as it ends.
    """

    model: Model
    fixed: Collection[str] = ()
    bounds: Bounds | None = None
    roles: Mapping[Role, Sequence[Record]] = field(default_factory=dict)
    records: tuple[Record, ...] = ()
    checks: Mapping[Role, Sequence[Record]] = field(default_factory=dict)
    results: Mapping[str, Any] = field(default_factory=dict)
    models: Mapping[str, AnyModel] = field(default_factory=dict)
    stages: Sequence["Stage"] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    hold: Hold | None = None
    execution: Execution = Execution()

    @property
    def held(self) -> dict[str, Any]:
        """What every fit is given: `fixed` and `bounds`."""
        return {"fixed": self.fixed, "bounds": self.bounds}


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage:
    """One stage of a study.

    Parameters
    ----------
    name, does : str
        The name of its result, in files and tables; what it does, in a few words for the help.
    run : callable
        ``run(settings, task)`` returns the result: a `Fit`, or a frozen value marked `storable`.
    table, settings : str, frozen dataclass
        The table of a study file that holds its settings, "" if it has none, and what that table
        becomes: these values, but for the keys that stand in it.
    given : tuple of str
        Fields of the settings that the stage sets itself: no keys of the table.
    role : tuple of str
        Whose records it takes: the first of these roles that has any. None at all, no stage.
    needs, uses : tuple of str
        Stages whose results it takes: it is left out if one of ``needs`` was; of ``uses``, those
        there are.
    structured : bool
        Whether the result depends on the structure, its guess and bounds.
    linear : bool
        Whether it takes records for deviations about one flight condition: of a nonlinear structure
        such stages run only if a table asks for one of them.
    optional : bool
        Whether it runs only if the study has its table; if it then fails, all else is done first.
    kept : bool
        Whether the result is kept for the next run.
    command : str
        The command that runs the stage; "" for ``casid identify``. Such a stage keeps what it
        finds itself, in the folder of its task's execution.
    ahead : bool
        Whether it may run before its turn, in a process beside the stages before: it takes of them
        only what ``needs`` and ``uses`` say, and uses one processor.
    label : str
        The result's name among the models that are compared; "" if it is none.
    check : callable
        ``check(settings, task)`` refuses what cannot be, before any stage runs; the task has no
        results yet.
    examine : callable
        ``examine(settings, task)`` refuses what the records cannot give, once they are read and
        before any stage runs, of a stage whose table is there.
    start : str
        Of an estimator: the stage whose fit many fits by it start from.
    data : callable
        ``data(settings, task)`` returns what the settings, an `Estimator`, fit; None for a stage
        that is no estimator.
    show : callable
        ``show(result, content)`` returns its sections of the report.
    """

    name: str
    does: str
    run: Callable[[Any, Task], Any]
    table: str = ""
    settings: Any = None
    given: tuple[str, ...] = ()
    role: tuple[Role, ...] = ()
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    structured: bool = False
    linear: bool = False
    optional: bool = False
    kept: bool = True
    command: str = ""
    ahead: bool = False
    label: str = ""
    check: Callable[[Any, Task], None] = lambda _, task: None  # noqa: ARG005
    examine: Callable[[Any, Task], None] = lambda _, task: None  # noqa: ARG005
    start: str = ""
    data: Callable[[Any, Task], Any] | None = None
    show: Callable[[Any, Content], Iterable[Section]] = lambda _, content: ()  # noqa: ARG005


class LeftOutError(Exception):
    """A stage is not run this time."""


class Keep(Protocol):
    """Runs a stage, or returns what an earlier run of it left."""

    def __call__(self, stage: Stage, settings: Any, task: Task) -> Any:  # noqa: ANN401
        """Return the stage's result, or raise `LeftOutError`."""
        ...


def compute(stage: Stage, settings: Any, task: Task) -> Any:  # noqa: ANN401 - of any stage
    """Run a stage; a fit has the units of the task's channels, be it from responses alone."""
    found = stage.run(settings, task)
    units = common_units([each for role in task.roles.values() for each in role])
    return replace(found, units=units) if units and isinstance(found, Fit) else found


def watched(settings: Any, progress: Callable[[Progress], None]) -> Any:  # noqa: ANN401
    """Settings whose solver, if they have one, tells its iterations."""
    if not hasattr(settings, "solver"):
        return settings
    return replace(settings, solver=replace(settings.solver, progress=progress))


@dataclass(frozen=True, eq=False, kw_only=True)
class StageResults:
    """What stages found by name, and why optional ones did not."""

    results: Mapping[str, Any]
    models: Mapping[str, AnyModel]
    failures: Mapping[str, ConvergenceError]


def run_stages(
    task: Task,
    *,
    keep: Keep = compute,
    known: Mapping[str, Any] | None = None,
    begin: Callable[[Stage, Any, Task], None] | None = None,
) -> StageResults:
    """Run the stages of a task in turn, each behind those it takes from, through ``keep``.

    A stage whose table is missing in the settings has its own defaults, or is left out if optional;
    ``known`` results are not computed. ConvergenceError comes from one on which others may rest.
    Before each, ``begin`` is told of those behind it that may run ahead and have all they take.
    """
    results, models = dict(known or {}), dict[str, AnyModel]()
    failures: dict[str, ConvergenceError] = {}
    for k, stage in enumerate(task.stages):
        now = replace(task, results=dict(results), models=dict(models))
        if begin is not None:
            _begin_ready(begin, task.stages[k:], now)
        if stage.name not in results and (given := _given(stage, now)):
            try:
                results[stage.name] = keep(stage, *given)
            except LeftOutError:
                continue
            except ConvergenceError as error:
                if not stage.optional:
                    raise ConvergenceError(f"{error}{_doubts(results)}", error.best) from error
                failures[stage.name] = error
        if stage.label and stage.name in results:
            models[stage.label] = results[stage.name]
    return StageResults(results=results, models=models, failures=failures)


def _doubts(results: Mapping[str, Any]) -> str:
    """What results before a failure say against themselves, for they may be why; "" if nothing."""
    said = [text for each in results.values() for text in getattr(each, "doubts", tuple)()]
    return "\n".join(["", "Earlier doubts that may explain it:", *said]) if said else ""


def _begin_ready(
    begin: Callable[[Stage, Any, Task], None], stages: Sequence[Stage], task: Task
) -> None:
    """Begin stages behind the first that may run ahead and take nothing of those before them."""
    before = {stages[0].name}
    for stage in stages[1:]:
        apart = stage.ahead and stage.name not in task.results
        if apart and not before & {*stage.needs, *stage.uses} and (given := _given(stage, task)):
            begin(stage, *given)
        before.add(stage.name)


def _given(stage: Stage, task: Task) -> tuple[Any, Task] | None:
    """Settings and task of a stage that runs; None of another."""
    own = records_of(stage, task.roles)
    if not will_run(stage, task.settings, task.results, own):
        return None
    return task.settings.get(stage.table, stage.settings), replace(task, records=own)


def fitting(model: Model, stages: Sequence[Stage], tables: Collection[str]) -> tuple[Stage, ...]:
    """The stages for a structure: linear ones for a nonlinear structure only if asked for."""
    asked = any(stage.linear and stage.table in tables for stage in stages)
    if asked or not isinstance(model, NonlinearModel):
        return tuple(stages)
    return tuple(stage for stage in stages if not stage.linear)


def records_of(stage: Stage, roles: Mapping[Role, Sequence[Record]]) -> tuple[Record, ...]:
    """Records of the first of a stage's roles that has any."""
    return next((tuple(roles[role]) for role in stage.role if roles.get(role)), ())


def will_run(
    stage: Stage, tables: Collection[str], before: Collection[str], own: Sequence[Record]
) -> bool:
    """Whether a stage is wanted, and has all it needs of the stages before it and of records."""
    ready = all(name in before for name in stage.needs) and (bool(own) or not stage.role)
    return ready and (not stage.optional or stage.table in tables)


def runnable(task: Task) -> list[str]:
    """Names of the stages that will run."""
    before: list[str] = []
    for stage in task.stages:
        if will_run(stage, task.settings, before, records_of(stage, task.roles)):
            before.append(stage.name)
    return before


def check_task(task: Task) -> None:
    """Refuse settings of no stage, those of a stage that would not run, and what stages refuse."""
    tables = [stage.table for stage in task.stages if stage.table]
    before = runnable(task)
    for table, value in task.settings.items():
        if table not in tables:
            raise ValueError(f"no stage has a table [{table}]; {hint(table, tables)}")
        for stage in (each for each in task.stages if each.table == table):
            kind = type(stage.settings)
            if not isinstance(value, kind):
                raise ValueError(  # noqa: TRY004 - a bad argument
                    f"[{table}] is a {type(value).__name__}, expected {kind.__name__}"
                )
            if stage.name not in before:
                raise ValueError(f"[{table}] would not be read: {lacking(stage, task, before)}")
            stage.check(value, task)


def examine_task(task: Task) -> None:
    """Refuse what the records of a task cannot give to a stage whose table is there."""
    for stage in task.stages:
        if stage.table in task.settings:
            stage.examine(task.settings[stage.table], task)


def lacking(stage: Stage, task: Task, before: Collection[str]) -> str:
    """What a stage would need to run."""
    if stage.role and not records_of(stage, task.roles):
        return f"it needs records; write [records.{stage.role[0]}]"
    missing = next(name for name in stage.needs if name not in before)
    first = next((each for each in task.stages if each.name == missing), None)
    return f"no stage is called {missing!r}" if first is None else lacking(first, task, before)
