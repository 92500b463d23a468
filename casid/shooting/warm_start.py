"""Where a solution leads under other bounds: the quadratic model of its cost, minimised.

At a solution nearby the cost of λ alone, biases and nodes eliminated (`casid.shooting.precision`),
is g ᵀd + ½ dᵀF d to second order. Its minimum within the new bounds and ties is a small quadratic
programme, which tells which of them will hold and at what price before a sample is touched. Models
about the solutions of models, with all second derivatives, are Newton's method with bounds
(sequential quadratic programming: Nocedal and Wright, Numerical Optimization, 2006, chapter 18),
which doubles its digits with every step once the right bounds hold.
"""

import logging
import time
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dposv

from casid.arrays import Array
from casid.nlp import Problem, Progress, Solution, SolverOptions, solve
from casid.shooting.newton import Newton
from casid.shooting.precision import quadratic_model
from casid.shooting.programme import Programme

LOG = logging.getLogger("casid")

SETS = 30  # of bounds that may hold, tried before IPOPT is asked
FALLS = 0.5  # share of the optimality error that two steps near the solution leave, at most
PRICED = 1e-10  # multiplier of a bound that holds, at least
CHEAP = 1e-2  # of the tolerance: bounds that cost little are to be reached too
# What IPOPT is asked for where ties hold a step.
QUADRATIC = {"tol": 1e-13, "compl_inf_tol": 1e-13, "acceptable_tol": 1e-11}
WITHIN = {"bound_relax_factor": 0.0}  # beside it, where bounds are to hold to the last digit
STATED = 1e-3  # of log-likelihood that an undamped step may still gain: 0.05 standard errors
ROOM = 1e-8  # that IPOPT gives bounds: without it, costs would differ by as much times the price
MANY = 200  # of its iterations


@dataclass(frozen=True, eq=False)
class Iterate:
    """Scaled variables with the multipliers of bounds and constraints, per observation.

    ``model`` is the one whose solution they are, if any, as `quadratic_model` has it.
    """

    x: Array
    bounds: Array
    constraints: Array
    model: tuple[Array, Array] | None = None

    @classmethod
    def of(cls, programme: Programme, x: Array) -> "Iterate":
        """Scaled variables with prices of continuity that leave the nodes no slope, no others."""
        blocks, links = programme.blocks(x), programme.links
        costates = np.zeros_like(blocks.gn)  # from the end of each record back
        for j in links[::-1].tolist():
            costates[j] = blocks.gn[j + 1] / programme.n + blocks.slope_n[j + 1].T @ costates[j + 1]
        constraints = np.zeros(len(programme.values(x).g))
        constraints[: costates[links].size] = costates[links].ravel()
        return cls(x, np.zeros(len(x)), constraints)

    def carried(self, last: Programme, programme: Programme) -> "Iterate":
        """The same in the units of another programme than the last."""
        (x, g), (new_x, new_g) = last.units(), programme.units()
        bounds, constraints = self.bounds * new_x / x, self.constraints * new_g / g
        return Iterate(self.x * x / new_x, bounds, constraints)

    def error(self, programme: Programme) -> float:
        """By how much the optimality conditions (Karush, Kuhn, Tucker) are missed, at most."""
        slopes = programme.gradient(self.x) + self.bounds
        slopes += programme.constraint_matrix(self.x).T @ self.constraints
        return max(float(np.abs(slopes).max()), self.broken(programme))

    def broken(self, programme: Programme) -> float:
        """How far it is beyond bounds and constraints, or from those that have a price, at most."""
        (lower, upper), (lower_c, upper_c) = programme.limits()
        g, nf = programme.values(self.x).g, len(lower)
        closed = np.zeros(len(g) - len(lower_c))  # the intervals
        low, high = np.concatenate([closed, lower_c]), np.concatenate([closed, upper_c])
        alone = _missed(self.x[:nf], lower, upper, self.bounds[:nf])
        return max(alone, _missed(g, low, high, self.constraints))

    def left(self, programme: Programme) -> float:
        """Log-likelihood that a step would still gain by the last model's curvature."""
        if self.model is None:
            return np.inf
        (F, follow), nf = self.model, programme.evaluator.nf
        slopes = (
            programme.gradient(self.x) + programme.constraint_matrix(self.x).T @ self.constraints
        )
        free = np.abs(self.bounds[:nf]) < PRICED
        if not free.any():
            return 0.0
        g = programme.n * (slopes[:nf] + follow[: len(slopes) - nf, :nf].T @ slopes[nf:])[free]
        d, failed = dposv(F[:-1, :-1][np.ix_(free, free)], g)[1:]
        return np.inf if failed else float(g @ d) / 2

    def moved(self, programme: Programme, options: SolverOptions) -> "Iterate | None":
        """The solution of the quadratic model here, Newton's; None if it has none."""
        try:
            hessian = Newton(programme).matrix(self.x, self.constraints)
            F, follow = quadratic_model(programme, self.x, hessian)
        except (RuntimeError, np.linalg.LinAlgError):  # an exactly singular factor
            return None
        nf, size = programme.evaluator.nf, len(self.x)
        found = step(programme, self.x, F, options, self.bounds[:nf])
        if not found.success:
            return None
        ties = len(found.multipliers_g)
        gaps = len(self.constraints) - ties
        rest = follow @ [*found.x, 1.0]  # biases, nodes, auxiliary variables, multipliers
        bounds = np.zeros(size)
        bounds[:nf] = found.multipliers_x
        prices = rest[len(rest) - gaps :] / programme.n
        return Iterate(
            x=self.x + np.concatenate([found.x, rest[: size - nf]]),
            bounds=bounds,
            constraints=np.concatenate([prices, found.multipliers_g]),
            model=(F, follow),
        )


def _missed(values: Array, lower: Array, upper: Array, prices: Array) -> float:
    """How far values are beyond limits, or from those they have a price for, times the price."""
    beyond = np.maximum(lower - values, values - upper)
    with np.errstate(invalid="ignore"):  # no price for what is endlessly far
        slack = np.abs(prices * np.where(prices > 0, upper - values, values - lower))
    return float(np.maximum(beyond, np.where(prices == 0, 0.0, slack) / CHEAP).max(initial=0.0))


def predicted(
    programme: Programme, at: Iterate, steps: int, options: SolverOptions
) -> Iterate | None:
    """The solution to expect from an iterate near one; λ may lie outside the bounds.

    By ``steps`` quadratic models, each about the solution of the last; None if one of them has no
    solution.
    """
    found: Iterate | None = at
    for _ in range(steps):
        found = None if found is None else found.moved(programme, options)
    return found


def followed(
    programme: Programme, at: Iterate, options: SolverOptions, stage: str
) -> Solution | None:
    """The solution, to the tolerance, by quadratic models alone; None where they do not lead there.

    They lead there as long as any two leave at most half of the error of the optimality conditions
    that each should leave nothing of: one may find that a bound is on a kink. From an iterate near
    the solution.
    """
    begin, last, before = time.perf_counter(), np.inf, np.inf
    programme = programme.roomier(ROOM)
    ipopt = QUADRATIC | WITHIN
    exact = replace(options, progress=None, max_iterations=MANY, ipopt=ipopt)
    for iteration in range(options.max_iterations + 1):
        values, seconds = programme.values(at.x), time.perf_counter() - begin
        error = at.error(programme) if np.isfinite(values.cost) else np.inf
        if options.progress is not None:
            told = Progress(stage=stage, iteration=iteration, cost=values.cost, seconds=seconds)
            options.progress(told)
        if error <= options.tolerance and at.left(programme) <= STATED:
            status = "solved by quadratic models"
            said = stage, status, iteration, values.cost, seconds
            LOG.info("%s: %s, %d steps, cost %.6g, %.2f s", *said)
            return Solution(
                x=at.x,
                f=values.cost,
                g=values.g,
                multipliers_x=at.bounds,
                multipliers_g=at.constraints,
                success=True,
                status=status,
                iterations=iteration,
                seconds=seconds,
            )
        falls, last, before = error < FALLS * max(last, before), error, last
        moved = at.moved(programme, exact) if falls and seconds < options.max_seconds else None
        if moved is None:
            break
        at = moved
    LOG.info("%s: quadratic models do not lead to the solution", stage)
    return None


def step(
    programme: Programme, x: Array, F: Array, options: SolverOptions, prices: Array | None = None
) -> Solution:
    """Step of the unknowns that minimises a quadratic model within bounds and ties.

    ``prices`` (nf,) of bounds say which may be expected to hold.
    """
    nf = programme.evaluator.nf
    (lower, upper), (lower_c, upper_c) = programme.limits()
    first = len(programme.links) * programme.evaluator.nx
    slopes = programme.constraint_matrix(x)[first:, :nf].toarray()
    if not len(slopes):
        box = F / programme.n, lower - x[:nf], upper - x[:nf]
        if found := in_box(*box, prices) or in_box(*box):
            return found
    now = programme.values(x).g[first:]
    d = ca.MX.sym("d", nf)
    problem = Problem(
        x=d,
        f=ca.bilin(ca.DM(F / programme.n), ca.vertcat(d, 1)) / 2,
        g=ca.mtimes(ca.DM(slopes), d) if len(slopes) else ca.MX(0, 1),
        x0=np.zeros(nf),
        lower_x=lower - x[:nf],
        upper_x=upper - x[:nf],
        lower_g=lower_c - now,
        upper_g=upper_c - now,
    )
    return solve(problem, options, stage="output error, prediction")


def in_box(F: Array, lower: Array, upper: Array, prices: Array | None = None) -> Solution | None:
    """The d within bounds (n,) that minimises half the form F (n + 1, n + 1) of [d; 1].

    By a primal-dual active set (M. Hintermüller, K. Ito, K. Kunisch, SIAM J. Optim. 13(3), 2002):
    bounds hold that the last d breaks or presses on, until these are the same as before, beginning
    with those of ``prices`` (n,) other than zero. None if they do not come to an end, or without
    them the form is not convex.
    """
    H, g, pinned = F[:-1, :-1], F[:-1, -1], upper <= lower
    size = np.maximum(np.diag(H), 1e-300)
    sides = np.zeros(len(g)) if prices is None else np.sign(prices)  # 1 at the upper bound
    sides = np.where(np.isfinite(np.where(sides > 0, upper, lower)), sides, 0).astype(int)
    sides[pinned] = 1
    for count in range(SETS):
        free = sides == 0
        d = np.where(free, 0.0, np.where(sides > 0, upper, lower))
        if free.any():
            _, d[free], failed = dposv(H[np.ix_(free, free)], -(H @ d + g)[free])
            if failed or not np.isfinite(d).all():
                return None
        prices = np.where(free, 0.0, -(H @ d + g))
        above, below = prices + size * (d - upper) > 0, prices + size * (d - lower) < 0
        last, sides = sides, np.where(pinned, 1, above.astype(int) - below)
        if (sides == last).all():
            return Solution(
                x=d,
                f=float(d @ H @ d / 2 + g @ d),
                g=np.zeros(0),
                multipliers_x=prices,
                multipliers_g=np.zeros(0),
                success=True,
                status="solved",
                iterations=count,
                seconds=0.0,
            )
    return None
