"""Where a solution leads under other bounds: the quadratic model of its cost, minimised.

At a solution nearby the cost of λ alone, biases and nodes eliminated (`casid.shooting.precision`),
is g ᵀd + ½ dᵀF d to second order. Its minimum within the new bounds and ties is a small quadratic
programme, which tells which of them will hold and at what price before a sample is touched.
"""

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.nlp import Problem, SolverOptions, solve
from casid.shooting.precision import quadratic_model
from casid.shooting.programme import Programme


def predicted(
    programme: Programme, x: Array, options: SolverOptions
) -> tuple[Array, tuple[Array, Array]] | None:
    """Scaled variables of the solution to expect, and multipliers of bounds and constraints.

    Parameters
    ----------
    programme : Programme
        With the new bounds and ties.
    x : (n,) array
        Scaled variables near a solution; λ may lie outside the bounds.
    options : SolverOptions
        Tolerance.

    Returns
    -------
    None if the quadratic programme has no solution.
    """
    F, follow = quadratic_model(programme, x)
    nf, n = programme.evaluator.nf, programme.n
    d = ca.MX.sym("d", nf)
    (lower, upper), (lower_c, upper_c) = programme.limits()
    continuity = len(programme.links) * programme.evaluator.nx
    ties = programme.constraint_matrix(x)[continuity:, :nf].toarray()
    now = programme.values(x).g[continuity:]
    problem = Problem(
        x=d, f=ca.bilin(ca.DM(F / n), ca.vertcat(d, 1)) / 2,
        g=ca.mtimes(ca.DM(ties), d) if len(ties) else ca.MX(0, 1), x0=np.zeros(nf),
        lower_x=lower - x[:nf], upper_x=upper - x[:nf],
        lower_g=lower_c - now, upper_g=upper_c - now,
    )  # fmt: skip
    found = solve(problem, options, stage="output error, prediction")
    if not found.success:
        return None
    bounds, rest = np.zeros(len(x)), np.zeros(continuity)
    bounds[:nf] = found.multipliers_x
    moved = np.concatenate([x[:nf] + found.x, x[nf:] + follow @ [*found.x, 1.0]])
    return moved, (bounds, np.concatenate([rest, found.multipliers_g]))
