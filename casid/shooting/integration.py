"""How much the steps of the integration move the estimates of a nonlinear structure.

At a solution the reduced gradient g of the cost with steps of half the length says by how much the
estimates would move with them, -P (g' - g) to first order, P their covariance for white residuals.
The method being of fourth order, what is left then is a fifteenth of that.
"""

import numpy as np
import scipy

from casid.arrays import Array
from casid.shooting.nonlinear import MOST, Integration, NonlinearEvaluator
from casid.shooting.precision import held, quadratic_model
from casid.shooting.programme import Programme
from casid.shooting.uncertainty import bound

SHIFT = 0.02  # standard deviations that halving the steps may move an estimate
EXACT = 1e-4  # the same where it costs little
CHEAP = 20_000  # steps in all
ORDER = 4  # of the method


def integration(programme: Programme, x: Array) -> Integration:
    """What halving the steps would change at a solution x in scaled variables."""
    evaluator = programme.evaluator
    assert isinstance(evaluator, NonlinearEvaluator)
    finer = programme.variant(evaluator=evaluator.finer(2))
    (F, g), (_, g_finer) = _reduced(programme, x), _reduced(finer, x)
    P = bound(F, held(programme, x), np.diag(programme.blocks(x).Hll))
    size = np.sqrt(np.diag(P))
    known = np.isfinite(size) & (size > 0)
    shift = np.zeros(len(g))
    shift[known] = np.abs(P[np.ix_(known, known)] @ (g_finer - g)[known]) / size[known]
    worst = int(np.argmax(shift))
    return Integration(
        steps=evaluator.substeps, shift=float(shift[worst]), moved=programme.free.names[worst]
    )


def _reduced(programme: Programme, x: Array) -> tuple[Array, Array]:
    """Information and gradient of the scaled unknowns, all else following."""
    upper = programme.hessian_matrix(x)
    F, _ = quadratic_model(programme, x, upper + scipy.sparse.triu(upper, 1).T)
    return F[:-1, :-1], F[:-1, -1]


def factor_wanted(found: Integration, samples: int) -> int:
    """By what to multiply the number of steps of the samples; 1 if they are short enough."""
    for allowed, most in ((EXACT, CHEAP // samples), (SHIFT, MOST)):
        if found.shift > allowed and 2 * found.steps <= min(most, MOST):
            more = 2 ** int(np.ceil(np.log2(found.shift / allowed) / ORDER))
            return int(max(2, min(more, 8, most // found.steps)))
    return 1
