"""How much the steps of the integration move the estimates of a nonlinear structure.

At a solution the reduced gradient g of the cost with steps of half the length says by how much the
estimates would move with them, -P (g' - g) to first order, P their covariance for white residuals.
The method being of fourth order, what is left then is a fifteenth of that.

Near where the method diverges the cost is steep for that alone, and P small: it is compared with
that of steps of half the length, for which this is twice as far.
"""

import numpy as np
import scipy

from casid.arrays import Array
from casid.display import counted
from casid.shooting.nonlinear import Integration, NonlinearEvaluator
from casid.shooting.precision import held, quadratic_model
from casid.shooting.programme import Programme
from casid.shooting.stiffness import MOST, fastest_flown
from casid.shooting.uncertainty import bound

SHIFT = 0.02  # standard deviations that halving the steps may move an estimate, or change by
EXACT = 1e-4  # the same where it costs little
CHEAP = 20_000  # steps in all
ORDER = 4  # of the method


def integration(programme: Programme, x: Array) -> Integration:
    """What halving the steps would change at a solution x in scaled variables."""
    evaluator = programme.evaluator
    assert isinstance(evaluator, NonlinearEvaluator)
    finer = programme.variant(evaluator=evaluator.finer(2))
    alone, ties = np.diag(programme.blocks(x).Hll), held(programme, x)
    (F, g), (F_finer, g_finer) = _reduced(programme, x), _reduced(finer, x)
    P, P_finer = bound(F, ties, alone), bound(F_finer, ties, np.diag(finer.blocks(x).Hll))
    size, after = np.sqrt(np.diag(P)), np.sqrt(np.diag(P_finer))
    known = np.isfinite(size) & (size > 0)
    shift = np.zeros(len(g))
    shift[known] = np.abs(P[np.ix_(known, known)] @ (g_finer - g)[known]) / size[known]
    worst = int(np.argmax(shift))
    return Integration(
        steps=evaluator.substeps,
        shift=float(shift[worst]),
        moved=programme.free.names[worst],
        widened=float(np.abs(after[known] / size[known] - 1).max(initial=0.0)),
    )


def _reduced(programme: Programme, x: Array) -> tuple[Array, Array]:
    """Information and gradient of the scaled unknowns, all else following."""
    upper = programme.hessian_matrix(x)
    F, _ = quadratic_model(programme, x, upper + scipy.sparse.triu(upper, 1).T)
    return F[:-1, :-1], F[:-1, -1]


def factor_wanted(found: Integration, samples: int) -> int:
    """By what to multiply the number of steps of the samples; 1 if they are short enough."""
    worst = max(found.shift, found.widened)
    for moved, allowed, most in ((found.shift, EXACT, CHEAP // samples), (worst, SHIFT, MOST)):
        if moved > allowed and 2 * found.steps <= min(most, MOST):
            more = np.ceil(np.log2(min(moved / allowed, 8.0**ORDER)) / ORDER)
            return int(max(2, min(2**more, most // found.steps)))
    return 1


def still_coarse(found: Integration, evaluator: NonlinearEvaluator, lam: Array) -> str:
    """What to say of steps that are too long; empty if they are not."""
    if max(found.shift, found.widened) <= SHIFT:
        return ""
    rate, state = fastest_flown(evaluator, lam)
    does = f"move {found.moved} by {found.shift:.2g} standard errors when halved"
    if found.widened > SHIFT:
        does = (
            "restrict estimates more than the data do (halving them changes a standard error by "
            f"{found.widened:.0%})"
        )
    more = f"write {state} in its steady state, or keep its lag longer by bounds"
    if 2 * found.steps <= MOST:
        more = "give more, or leave steps out to have them chosen"
    return (
        f"{counted(found.steps, 'integration step')} within {evaluator.layout.classes.max():.3g} s "
        f"{does}; the fastest mode, mostly of {state}, is at {rate:.3g} rad/s: {more}"
    )
