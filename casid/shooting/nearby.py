"""Where a solution leads under other bounds: the quadratic model of its cost, minimised.

At a solution nearby the cost of λ alone, biases and nodes eliminated (`casid.shooting.precision`),
is g ᵀd + ½ dᵀF d to second order. Its minimum within the new bounds and ties is a small quadratic
programme, which tells which of them will hold and at what price before a sample is touched.
"""

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dposv

from casid.arrays import Array
from casid.nlp import Problem, Solution, SolverOptions, solve
from casid.shooting.newton import Newton
from casid.shooting.precision import quadratic_model
from casid.shooting.programme import Programme

SETS = 30  # of bounds that may hold, tried before IPOPT is asked


def predicted(
    programme: Programme, x: Array, steps: int, options: SolverOptions
) -> tuple[Array, tuple[Array, Array]] | None:
    """Scaled variables of the solution to expect, and multipliers of bounds and constraints.

    From ``x`` (n,), scaled variables near a solution, by ``steps`` quadratic models, each about the
    solution of the last; λ may lie outside the bounds. None if one of them has no solution.
    """
    newton, count = Newton(programme), len(programme.links) * programme.evaluator.nx
    bounds, prices = np.zeros(len(x)), np.zeros(len(programme.values(x).g))
    nf = programme.evaluator.nf
    for _ in range(steps):
        try:
            F, follow = quadratic_model(programme, x, newton.matrix(x, prices))
        except (RuntimeError, np.linalg.LinAlgError):  # an exactly singular factor
            return None
        found = step(programme, x, F, options)
        if not found.success:
            return None
        moved = follow @ [*found.x, 1.0]
        bounds[:nf] = found.multipliers_x
        x = x + np.concatenate([found.x, moved[: len(x) - nf]])
        prices = np.concatenate([moved[len(moved) - count :] / programme.n, found.multipliers_g])
    return x, (bounds, prices)


def step(programme: Programme, x: Array, F: Array, options: SolverOptions) -> Solution:
    """Step of the unknowns that minimises a quadratic model within bounds and ties."""
    nf = programme.evaluator.nf
    (lower, upper), (lower_c, upper_c) = programme.limits()
    first = len(programme.links) * programme.evaluator.nx
    slopes = programme.constraint_matrix(x)[first:, :nf].toarray()
    if not len(slopes) and (found := in_box(F / programme.n, lower - x[:nf], upper - x[:nf])):
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


def in_box(F: Array, lower: Array, upper: Array) -> Solution | None:
    """The d within bounds (n,) that minimises half the form F (n + 1, n + 1) of [d; 1].

    By a primal-dual active set (M. Hintermüller, K. Ito, K. Kunisch, SIAM J. Optim. 13(3), 2002):
    bounds hold that the last d breaks or presses on, until these are the same as before. None if
    they do not come to an end, or without them the form is not convex.
    """
    H, g, pinned = F[:-1, :-1], F[:-1, -1], upper <= lower
    size = np.maximum(np.diag(H), 1e-300)
    sides = pinned.astype(int)  # 1 at the upper bound, -1 at the lower
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
