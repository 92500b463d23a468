"""Where a solution leads under other bounds: the quadratic model of its cost, minimised.

At a solution nearby the cost of λ alone, biases and nodes eliminated (`casid.shooting.precision`),
is g ᵀd + ½ dᵀF d to second order. Its minimum within the new bounds and ties is a small quadratic
programme, which tells which of them will hold and at what price before a sample is touched.
"""

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.nlp import Problem, Solution, SolverOptions, solve
from casid.shooting.newton import Newton
from casid.shooting.precision import quadratic_model
from casid.shooting.programme import Programme


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
    d = ca.MX.sym("d", nf)
    (lower, upper), (lower_c, upper_c) = programme.limits()
    first = len(programme.links) * programme.evaluator.nx
    slopes = programme.constraint_matrix(x)[first:, :nf].toarray()
    now = programme.values(x).g[first:]
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
