"""Solve a nonlinear programme with IPOPT; the only call of ``casadi.nlpsol``."""

import io
import logging
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, redirect_stderr
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array

LOG = logging.getLogger("casid")

COARSEST = 0.1  # tolerance: beyond it nothing is solved
SOLVED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
STATUS = {  # IPOPT's word, what it means and what to do
    "Solve_Succeeded": "solved",
    "Solved_To_Acceptable_Level": "solved to IPOPT's acceptable level",
    "Maximum_Iterations_Exceeded": "iteration limit reached; raise max_iterations or start nearer",
    "Maximum_CpuTime_Exceeded": "time limit reached; raise max_seconds",
    "Maximum_WallTime_Exceeded": "time limit reached; raise max_seconds",
    "Infeasible_Problem_Detected": "no feasible point was found near here; start nearer, or "
    "relax ties and bounds if there are any",
    "Restoration_Failed": "no feasible step found; start nearer, or check the scale of the "
    "parameters",
    "Search_Direction_Becomes_Too_Small": "no further progress at this precision; loosen tolerance",
    "Diverging_Iterates": "the iterates diverge; bound the parameters, or look for a bound or a "
    "unit that excludes the solution",
    "Invalid_Number_Detected": "the model gave NaN or infinity; check its formulas at the bounds",
    "User_Requested_Stop": "stopped by the caller",
    "NonIpopt_Exception_Thrown": "evaluating the model failed; see the log",
}


@dataclass(frozen=True, kw_only=True)
class Progress:
    """One line of progress of a long computation."""

    stage: str
    iteration: int
    cost: float
    seconds: float

    def __str__(self) -> str:
        """What runs, and where it is once it has begun to iterate."""
        at = f"iteration {self.iteration}, cost {self.cost:.6g}, {self.seconds:.1f} s"
        return f"{self.stage}: {at if self.iteration else '...'}"


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """Limits, tolerance and progress of a solver.

    Parameters
    ----------
    tolerance : float
        Relative optimality tolerance.
    max_iterations, max_seconds : int, float
        Limits of each solve, its iterations and its time by the wall clock [s]. A fit makes several
        (a round for every R or spectrum, delays across samples, shorter intervals, other starts)
        and may take a multiple of both; ``Fit.iterations`` are those of the solves that led to its
        end.
    progress : callable
        Called with a `Progress` after every iteration; it does not travel to other processes.
    ipopt : mapping
        Options passed to IPOPT unread, for those who know them.
    """

    tolerance: float = 1e-8
    max_iterations: int = 500
    max_seconds: float = 1e4
    progress: Callable[[Progress], None] | None = field(default=None, compare=False)
    ipopt: Mapping[str, float | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, least in (("tolerance", 1e-15), ("max_iterations", 1), ("max_seconds", 1e-9)):
            value = getattr(self, name)
            if not least <= value < np.inf:
                raise ValueError(f"{name} = {value}, expected at least {least:g}, and finite")
        if self.tolerance > COARSEST:
            raise ValueError(f"tolerance = {self.tolerance}, expected at most {COARSEST:g}")

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"progress": None}


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """min f(x) subject to lower_x <= x <= upper_x, lower_g <= g(x) <= upper_g, in SX or MX.

    ``hessian`` is a function of IPOPT's (x, p, lam_f, lam_g) that replaces the exact one of the
    Lagrangian (upper triangle), ``functions`` are others ("nlp_f", "nlp_g", "nlp_grad_f",
    "nlp_jac_g"), ``kept`` those that CasADi would not keep alive.
    """

    x: Any
    f: Any
    g: Any
    x0: Array
    lower_x: Array
    upper_x: Array
    lower_g: Array
    upper_g: Array
    hessian: ca.Function | None = None
    functions: Mapping[str, ca.Function] = field(default_factory=dict)
    kept: tuple[ca.Function, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Solution:
    """What IPOPT found; ``multipliers`` are those of the bounds and of the constraints.

    A positive multiplier presses on the upper bound, a negative one on the lower: at the solution
    df/dx + multipliers_x + (dg/dx)ᵀ multipliers_g = 0.
    """

    x: Array
    f: float
    g: Array
    multipliers_x: Array
    multipliers_g: Array
    success: bool
    status: str
    iterations: int
    seconds: float


def solve(
    problem: Problem, options: SolverOptions, *, stage: str, warm: tuple[Array, Array] | None = None
) -> Solution:
    """Solve one programme.

    Parameters
    ----------
    problem : Problem
        Scaled by the caller.
    options : SolverOptions
        Limits and tolerance.
    stage : str
        What progress and log lines call this solve.
    warm : pair of arrays
        Multipliers (of bounds, of constraints) of a solution nearby; switches the warm start on.

    Returns
    -------
    Solution
        With ``success`` False and the last iterate when IPOPT stopped early; never an exception
        for that.
    """
    start = time.perf_counter()
    watcher = _Watcher(problem, options, stage, start)
    solver = _solver(problem, options, watcher, warm)
    arguments = {
        "x0": problem.x0,
        "lbx": problem.lower_x,
        "ubx": problem.upper_x,
        "lbg": problem.lower_g,
        "ubg": problem.upper_g,
    }
    if warm is not None:
        arguments |= {"lam_x0": warm[0], "lam_g0": warm[1]}
    with _interruptible():
        found = solver(**arguments)
    stats = solver.stats()
    word = "Maximum_WallTime_Exceeded" if watcher.late else stats["return_status"]
    meaning = STATUS.get(word, str(word))
    x, cost, iterations = found["x"].full().ravel(), float(found["f"]), int(stats["iter_count"])
    seconds = time.perf_counter() - start
    told = stage, meaning, iterations, cost, seconds
    LOG.info("%s: %s, %d iterations, cost %.6g, %.2f s", *told)
    finite = bool(np.isfinite(x).all() and np.isfinite(cost))
    return Solution(
        x=x,
        f=cost,
        g=found["g"].full().ravel(),
        multipliers_x=found["lam_x"].full().ravel(),
        multipliers_g=found["lam_g"].full().ravel(),
        success=word in SOLVED and finite,
        status=meaning if finite else STATUS["Invalid_Number_Detected"],
        iterations=iterations,
        seconds=seconds,
    )


def _solver(
    problem: Problem, options: SolverOptions, watcher: "_Watcher", warm: tuple[Array, Array] | None
) -> ca.Function:
    """The programme as a function of CasADi's; options that IPOPT refuses are told."""
    nlp: Any = {"x": problem.x, "f": problem.f, "g": problem.g}
    try:
        return ca.nlpsol("solver", "ipopt", nlp, _settings(problem, options, watcher, warm))
    except RuntimeError as error:
        if not options.ipopt or "IPOPT option" not in str(error):
            raise
        reason = str(error).splitlines()[-1].partition(": ")[2]
        raise ValueError(
            f"IPOPT refuses the options {dict(options.ipopt)}: {reason}; its own list has them all"
        ) from error


@contextmanager
def _interruptible() -> Iterator[None]:
    """Raise an interrupt from the keyboard that CasADi took for a failure of the model."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    interrupted, unheard = False, ExitStack()

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        try:
            before(number, frame)
        except KeyboardInterrupt:
            interrupted = True
            unheard.enter_context(redirect_stderr(io.StringIO()))  # CasADi's warning of it
            raise

    signal.signal(signal.SIGINT, note)
    try:
        with unheard:
            yield
    except Exception:
        if not interrupted:
            raise
    finally:
        signal.signal(signal.SIGINT, before)
    if interrupted:
        raise KeyboardInterrupt


def _settings(
    problem: Problem, options: SolverOptions, watcher: "_Watcher", warm: tuple[Array, Array] | None
) -> dict[str, Any]:
    ipopt: dict[str, Any] = {"print_level": 0, "sb": "yes", "tol": options.tolerance}
    ipopt["max_iter"] = options.max_iterations
    if warm is not None:
        ipopt |= {"warm_start_init_point": "yes", "mu_init": 1e-4}
    settings: dict[str, Any] = {"print_time": False, "ipopt": ipopt | dict(options.ipopt)}
    settings["iteration_callback"] = watcher
    settings["show_eval_warnings"] = False  # IPOPT steps back from points without a value
    if problem.hessian is not None:
        settings["hess_lag"] = problem.hessian
    for name, function in problem.functions.items():
        settings[name.removeprefix("nlp_")] = function
    if problem.functions:  # CasADi would differentiate what the caller evaluates without it
        settings["no_nlp_grad"] = True
    return settings


class _Watcher(ca.Callback):
    """Tells of IPOPT's iterations and stops it in time, whose own limit goes by the wall clock."""

    def __init__(self, problem: Problem, options: SolverOptions, stage: str, start: float) -> None:
        ca.Callback.__init__(self)
        self._sizes = (len(problem.x0), len(problem.lower_g))
        self._options, self._stage, self._start = options, stage, start
        self._iteration, self.late = 0, False
        self.construct("watcher", {})

    def get_n_in(self) -> int:
        return ca.nlpsol_n_out()

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        name, (n, m) = ca.nlpsol_out(i), self._sizes
        sizes = {"f": 1, "x": n, "lam_x": n, "g": m, "lam_g": m}
        return ca.Sparsity.dense(sizes[name]) if name in sizes else ca.Sparsity(0, 0)

    def eval(self, arguments: Any) -> list[int]:  # noqa: ANN401 - CasADi's own
        seconds = time.perf_counter() - self._start
        if self._options.progress is not None:
            cost = float(arguments[ca.nlpsol_out().index("f")])
            self._options.progress(
                Progress(stage=self._stage, iteration=self._iteration, cost=cost, seconds=seconds)
            )
        self._iteration += 1
        self.late = seconds > self._options.max_seconds
        return [int(self.late)]
