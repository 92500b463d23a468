"""The multiple-shooting programme as IPOPT solves it, by Gauss-Newton steps and then Newton's.

Far from the solution the Hessian is Gauss-Newton's. Once the intervals meet and a step gains less
than one unit of log-likelihood, the curvature of outputs and end states is added
(`casid.shooting.curvature`), and that of the concentrated likelihood, which for a diagonal R takes

    Σ_i (2 / n_i) g_i g_iᵀ,    g_i the gradient of channel i's ½ Σ r²/R_ii,

off the Hessian H of held R. These are dense; so each channel has an auxiliary variable z_i, on
which neither cost nor constraints depend, and IPOPT solves with the sparse
[H, -g√(2/n); -gᵀ√(2/n), 1], from which the elimination of z leaves just that. All is evaluated by
NumPy on the blocks of all intervals.
"""

from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np
import scipy

from casid.arrays import Array
from casid.assembly import Pattern, evaluated, grid, stack
from casid.nlp import Problem, Solution
from casid.shooting.curvature import Curvature, curvature
from casid.shooting.nonlinear import NonlinearEvaluator, NonlinearSweep
from casid.shooting.nonlinear_curvature import hamiltonian
from casid.shooting.programme import Programme

MEET = 1e-2  # gaps between intervals that meet, in units of unit curvature
GAIN = 1.0  # of log-likelihood: a step that gains less ends within the confidence region
SHRINK, IN_TURN = 0.7, 2  # of the last step, that so many may exceed before Gauss-Newton goes on
LEAP = 10.0  # times the step into the neighbourhood: too long for one within


class Newton:
    """Cost, constraints and derivatives of a programme for IPOPT; auxiliary variables come last.

    ``close`` says that the start is as near the solution as Newton's steps need.
    """

    def __init__(self, programme: Programme, *, close: bool = False) -> None:
        self.programme = programme
        noise, e = programme.noise, programme.evaluator
        self._descent = _Descent(programme.n, close, exact=not isinstance(e, NonlinearEvaluator))
        self.auxiliary = e.ny if noise.concentrated and e.curved else 0

    def problem(self, start: Array) -> Problem:
        """The problem for `casid.nlp.solve`, from the programme's scaled variables."""
        more, pattern = self.auxiliary, self.programme.jacobian_pattern
        (lower, upper), (lower_c, upper_c) = self.programme.limits()
        nowhere = np.full(self.programme.size + more - len(lower), np.inf)
        closed = np.zeros(pattern.rows - len(lower_c))
        x = np.append(start, np.zeros(more)), np.append(lower, -nowhere), np.append(upper, nowhere)
        g = np.concatenate([closed, lower_c]), np.concatenate([closed, upper_c])
        J = ca.horzcat(pattern.sparsity, ca.Sparsity(pattern.rows, more))
        return evaluated(self, x, g, J, self._pattern.sparsity)

    @cached_property
    def _pattern(self) -> Pattern:
        return Pattern(*self.places(), size=self.programme.size + self.auxiliary)

    def cost(self, x: Array) -> float:
        """The cost per observation."""
        return float(self.programme.values(x[: self.programme.size]).cost)

    def gradient(self, x: Array) -> Array:
        """Its gradient."""
        slope = self.programme.gradient(x[: self.programme.size])
        return np.concatenate([slope, np.zeros(self.auxiliary)])

    def constraints(self, x: Array) -> Array:
        """Gaps between the intervals, then the structure's own."""
        return self.programme.values(x[: self.programme.size]).g

    def jacobian(self, x: Array) -> Array:
        """Nonzeros of their Jacobian."""
        return self.programme.jacobian(x[: self.programme.size])

    def hessian(self, x: Array, f: float, mu: Array) -> Array:
        """Nonzeros of the Hessian at IPOPT's iterate x: Newton's if that is close."""
        own = x[: self.programme.size]
        close = self._descent.close(own, self.programme.values(own).cost)
        return self._pattern.order(f * self.entries(own, mu / f if close and f > 0 else None))

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the entries of the Hessian's upper triangle."""
        own = self.programme.size
        auxiliary = own + np.arange(self.auxiliary)
        beside = grid(np.arange(own)[None], auxiliary[None])
        return stack([self.programme.hessian_places(), beside, (auxiliary, auxiliary)])

    def entries(self, x: Array, multipliers: Array | None) -> Array:
        """Entries of the Hessian of the cost and the constraints, per observation."""
        # Gauss-Newton's without multipliers, or where the intervals do not meet.
        programme, blocks = self.programme, self.programme.blocks(x)
        Hll, Hln, Hnn = blocks.Hll, blocks.Hln, blocks.Hnn
        pull: Array = np.zeros((programme.size, self.auxiliary))
        gaps = programme.values(x).g[: len(programme.links) * programme.evaluator.nx]
        meet = np.abs(gaps).max(initial=0.0) < MEET
        if multipliers is not None and meet and programme.evaluator.curved:
            more = self._curvature(x, multipliers[: len(gaps)])
            Hll, Hln, Hnn = Hll + more.Hll, Hln + more.Hln, Hnn + more.Hnn
            if self.auxiliary:
                pull = self._pull(more)
        core = programme.hessian_parts(blocks, Hll, Hln, Hnn) / programme.n
        return np.concatenate([core, -pull.ravel(), np.ones(self.auxiliary)])

    def matrix(self, x: Array, multipliers: Array) -> scipy.sparse.csc_array:
        """The Hessian of the whole cost's Lagrangian, symmetric, with the auxiliary variables."""
        n = self.programme.size + self.auxiliary
        entries = self.programme.n * self.entries(x, multipliers)
        upper = scipy.sparse.csc_array((entries, self.places()), (n, n))
        return scipy.sparse.csc_array(upper + scipy.sparse.triu(upper, 1).T)

    def _curvature(self, x: Array, multipliers: Array) -> Curvature:
        """What Gauss-Newton leaves out, in scaled variables; multipliers of the continuity."""
        programme, s = self.programme, self.programme.scales
        mu = np.zeros((programme.J, len(s.state)))
        mu[programme.links] = programme.n * multipliers.reshape(-1, len(s.state)) / s.state
        sweep = programme.blocks(x).sweep
        if isinstance(sweep, NonlinearSweep):
            found = hamiltonian(sweep, mu)
        else:
            found = curvature(sweep, mu)
        return Curvature(
            Hll=found.Hll * np.outer(s.lam, s.lam),
            Hln=found.Hln * np.outer(s.lam, s.state),
            Hnn=found.Hnn * np.outer(s.state, s.state),
            gl=found.gl * s.lam,
            gb=found.gb * s.bias,
            gn=found.gn * s.state,
        )

    def _pull(self, found: Curvature) -> Array:
        """Columns of the auxiliary variables: every channel's g √(2/n), per observation."""
        programme, noise = self.programme, self.programme.noise
        parts = [found.gl, *(part.reshape(len(part), -1) for part in (found.gb, found.gn))]
        g = np.hstack(parts if programme.biases else parts[::2]).T
        seen = noise.patterns.T @ noise.counts
        return np.asarray(g * np.sqrt(2 / (np.maximum(seen, 1) * programme.n)))

    def extended(self, multipliers: tuple[Array, Array]) -> tuple[Array, Array]:
        """Multipliers of the programme's own bounds and constraints, as those of the problem."""
        return np.concatenate([multipliers[0], np.zeros(self.auxiliary)]), multipliers[1]

    def stripped(self, solution: Solution) -> Solution:
        """A solution of the problem in the programme's own variables."""
        own = self.programme.size
        return replace(solution, x=solution.x[:own], multipliers_x=solution.multipliers_x[:own])


class _Descent:
    """Whether the iterates of one solve are close to its end, as their steps show.

    Newton's steps shrink there. One much longer than that into the neighbourhood was taken too
    early, where the curvature may have any sign; Gauss-Newton then goes on. It does too where steps
    with a curvature that is not ``exact`` do not shrink: over a sample in which fast modes die out
    that of `casid.shooting.nonlinear_curvature` may be far off.
    """

    def __init__(self, n: int, close: bool, *, exact: bool = True) -> None:
        self._n, self._close, self._early, self._exact = n, close, False, exact
        self._last: tuple[Array, float] | None = None
        self._entry = self._step = np.inf
        self._long = 0  # steps in turn that were hardly shorter than the one before

    def close(self, x: Array, cost: float) -> bool:
        """Whether x is close, the next iterate or the last again; its cost is per observation."""
        again = self._last is not None and np.array_equal(x, self._last[0])
        if self._last is not None and not again:
            step = float(np.abs(x - self._last[0]).max())
            self._early |= self._close and step > LEAP * self._entry
            self._long = self._long + 1 if self._close and step > SHRINK * self._step else 0
            self._early |= not self._exact and self._long >= IN_TURN
            self._step = step
            if not self._close:
                self._entry = step
            self._close = self._close or abs(cost - self._last[1]) * self._n < GAIN
        self._last = x.copy(), cost
        return self._close and not self._early
