"""Starting points of a match from the target alone.

With the states' responses X_k known, every row of A, B, C and D is a least-squares problem in λ:

    s_k X_k = A(λ) X_k + B(λ) e^(−s_k τ)        Ĝ_k = C(λ) X_k + D(λ) e^(−s_k τ)

and with λ known X_k is one. The two alternate. At first λ is known only to its sign or order of
magnitude, so each equation errs by what its parameters may still contribute. Weighted with the
covariance of these errors, the states follow from what the structure says without λ: kinematics,
an output that is a state, the difference of a specific force and the row of A that shares its
derivatives. The assumed spread of λ then shrinks from one alternation to the next.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.optimize

from casid.arrays import Array, ComplexArray
from casid.comparison import Comparison
from casid.lifted import state_responses
from casid.model import Free

SPREADS = (1.0, 1.0, 0.5, 0.2, 0.1)  # of λ about its present value, in units of its scale
NOISE = 1e-2  # error of an equation that has no parameter, relative to its terms
RIDGE = 1e-10  # weight, on the square, of present parameters of which the states say nothing
NEWTON = 6  # Gauss-Newton steps for the parameters


@dataclass(frozen=True, eq=False, kw_only=True)
class Start:
    """Where a match may start: free parameters (nf,) and the states' responses (K, nx, nu)."""

    name: str
    values: Array
    X: ComplexArray | None


def starts(free: Free, comparison: Comparison) -> tuple[Start, ...]:
    """Starting points, the most promising first.

    The least-squares one from the target, then the caller's guess.
    """
    found = _Equations(free, comparison).solve()
    guess = Start(name="guess", values=free.guess, X=None)
    return (guess,) if found is None else (found, guess)


class _Equations:
    """The structure's equations at all points, linear in the states and nearly so in λ."""

    def __init__(self, free: Free, comparison: Comparison) -> None:
        self._free, self._comparison = free, comparison
        lam = ca.SX.sym("lam", len(free.index))
        A, B, C, D, tau, _ = free.model.matrices()(free.full(lam))
        N = ca.densify(ca.blockcat([[A, B], [C, D]]))
        derivatives = [ca.densify(ca.jacobian(part, lam)) for part in (ca.vec(N), tau)]
        self._function = ca.Function("N", [lam], [N, ca.densify(tau), *derivatives])
        self.nx, self.nu, self.ny = A.shape[0], B.shape[1], C.shape[0]
        guess = state_responses(free.model.with_vector(free.full(free.guess)).system(), comparison)
        self._guess = np.where(np.isfinite(guess), guess, 0.0)
        size = np.sqrt(np.mean(np.abs(self._guess) ** 2, axis=(0, 2)))
        self.scale = np.where(size > 0, size, 1.0)

    def solve(self) -> Start | None:
        """The least-squares start; None when the numbers leave no usable one."""
        values = self._free.guess
        X = self._guess
        for sweep, spread in enumerate(SPREADS):
            X = self._states(values, X, spread)
            size = np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 2)))
            self.scale = np.where(size > 0, size, 1.0)
            if sweep:  # the first pass only finds the size of the states
                values = self._parameters(values, X)
        if not (np.isfinite(values).all() and np.isfinite(X).all()):
            return None
        return Start(name="target", values=values, X=X)

    def _numbers(self, values: Array) -> tuple[Array, Array, Array, Array]:
        """N (R, C), τ (nu,), dN/dλ (nf, R, C) and dτ/dλ (nf, nu)."""
        N, tau, dN, dtau = (part.full() for part in self._function(values))
        shape = (N.shape[1], N.shape[0], len(values))
        return N, tau.ravel(), dN.reshape(shape).transpose(2, 1, 0), dtau.T

    def _weights(self) -> Array:
        """Weights of the rows of every point and input, (K, nx + ny, nu)."""
        c = self._comparison
        rate = np.maximum(np.abs(c.s), 1e-12)
        state = 1 / (rate[:, None] * self.scale)
        state = np.repeat(state[:, :, None], self.nu, axis=2)
        return np.concatenate([state, c.W / c.input_scale], axis=1)

    def _inputs(self, tau: Array) -> ComplexArray:
        """Delayed scaled inputs, (K, nu, nu)."""
        c = self._comparison
        factors = np.exp(-c.s[:, None] * tau) * c.input_scale
        return np.asarray(factors[:, :, None] * np.eye(self.nu))

    def _states(self, values: Array, X: ComplexArray, spread: float) -> ComplexArray:
        """States that fit all equations best when the parameters may be off by their spread."""
        c = self._comparison
        N, tau, dN, _ = self._numbers(values)
        upper = c.s[:, None, None] * np.eye(self.nx) - N[: self.nx, : self.nx]
        lower = np.broadcast_to(-N[self.nx :, : self.nx], (len(c.s), self.ny, self.nx))
        M = np.concatenate([upper, lower], axis=1)
        y = np.concatenate([np.zeros((len(c.s), self.nx, self.nu)), c.G * c.input_scale], axis=1)
        R = N[:, self.nx :] @ self._inputs(tau) - y
        scaled = dN * (spread * self._free.scale[self._free.index])[:, None, None]
        weights = self._weights()
        X = X.copy()
        for j in range(self.nu):
            size = np.concatenate([self.scale, c.input_scale * (np.arange(self.nu) == j)])
            errors = scaled * size  # (nf, rows, columns)
            w = weights[:, :, j]
            cov = np.einsum("lrc,lqc->rq", errors, errors) * w[:, :, None] * w[:, None, :]
            white = np.linalg.inv(np.linalg.cholesky(cov + NOISE**2 * np.eye(len(N))))
            Mw, Rw = white @ (w[:, :, None] * M * self.scale), white @ (w * R[:, :, j])[:, :, None]
            MH = Mw.conj().transpose(0, 2, 1)
            prior = X[:, :, j, None] / self.scale[:, None]
            normal = MH @ Mw + RIDGE * np.eye(self.nx)
            X[:, :, j] = np.linalg.solve(normal, MH @ Rw + RIDGE * prior)[:, :, 0] * self.scale
        return X

    def _parameters(self, values: Array, X: ComplexArray) -> Array:
        """Parameters within their bounds that fit all equations best with these states."""
        free, c, weights = self._free, self._comparison, self._weights()
        scale = free.scale[free.index]
        prior = values

        def parts(x: Array) -> tuple[ComplexArray, ComplexArray, Array, Array, Array]:
            N, tau, dN, dtau = self._numbers(x)
            V = np.concatenate([X, self._inputs(tau)], axis=1)
            return V, self._inputs(tau), N, dN, dtau

        y = np.concatenate([c.s[:, None, None] * X, c.G * c.input_scale], axis=1)
        limits = free.lower[free.index] / scale, free.upper[free.index] / scale
        x = np.clip(values / scale, *limits)
        for _ in range(NEWTON):  # only delays and products of parameters need more than one step
            V, U, N, dN, dtau = parts(x * scale)
            r = weights * (N @ V - y)
            J = np.einsum("lrc,kcj->lkrj", dN, V)
            slope = -c.s[:, None, None] * U
            J += np.einsum("rc,lc,kcj->lkrj", N[:, self.nx :], dtau, slope)
            J = (weights * J).reshape(len(x), -1) * scale[:, None] / np.sqrt(len(c.s))
            step = _bounded_step(J, r.ravel() / np.sqrt(len(c.s)), prior / scale - x, x, limits)
            x = np.clip(x + step, *limits)
            if np.abs(step).max() < 1e-6 * max(1.0, np.abs(x).max()):
                break
        return np.asarray(x * scale)


def _bounded_step(
    J: ComplexArray, r: ComplexArray, prior: Array, x: Array, limits: tuple[Array, Array]
) -> Array:
    """Gauss-Newton step within the bounds, from the normal equations; J is (nf, residuals)."""
    normal = (J.conj() @ J.T).real + RIDGE * np.eye(len(x))
    right = (J.conj() @ -r).real + RIDGE * prior
    factor = np.linalg.cholesky(normal).T
    target = np.linalg.solve(factor.T, right)
    lower = np.minimum(limits[0] - x, -1e-12)
    upper = np.maximum(limits[1] - x, 1e-12)
    step = scipy.optimize.lsq_linear(factor, target, bounds=(lower, upper), method="bvls").x
    return np.asarray(step)
