"""The lifted programme of a fit in decibels and degrees.

The states' responses X_k at every frequency are variables beside the parameters, tied by

    (jω_k I − A(λ)) X_k = B(λ),        g = C(λ) X_k + D(λ),

bilinear constraints; the input delays turn the phase of g and appear nowhere else. The cost of one
point of a pair is that of T&R (see `casid.baseline.mismatch`) in the ratio z = g e^(−jωτ)/ĝ of
model to measurement: with ln z for the fit itself, with z − 1, which is the same to first order and
convex in g, for the way there.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casid.arrays import Array, ComplexArray
from casid.baseline.mismatch import DB, DEG, PHASE
from casid.blocks import Block, assemble
from casid.model import Free
from casid.nlp import Problem, Solution

TINY = 1e-12  # of |z|², keeps its logarithm finite where a model's response vanishes


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """What a model is fitted to, in its own channels.

    ``omega`` (K,) rad/s; ``G`` (K, ny, nu) measured, any number where there is none; ``weight``
    (K, ny, nu) W_γ 20/n_ω, zero where a point is not used; ``input_scale`` (nu,).
    """

    omega: Array
    G: ComplexArray
    weight: Array
    input_scale: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Programme:
    """A programme and how to read and write its vector."""

    problem: Problem
    free: Free
    target: Target
    state_scale: Array

    def pack(self, values: Array, X: ComplexArray) -> Array:
        """The vector of free parameters (nf,) and states' responses (K, nx, nu), as `unpack`."""
        scaled = (X / self.state_scale[:, None]).transpose(0, 2, 1).reshape(len(X), -1)
        local = np.hstack([scaled.real, scaled.imag])
        return np.concatenate([values / self.free.scale[self.free.index], local.ravel()])

    def unpack(self, x: Array) -> tuple[Array, ComplexArray]:
        """Free parameters within their bounds, and undelayed responses X to scaled inputs."""
        free, nf = self.free, len(self.free.index)
        values = x[:nf] * free.scale[free.index]
        values = np.clip(values, free.lower[free.index], free.upper[free.index])
        K, nu, nx = len(self.target.omega), len(self.target.input_scale), len(self.state_scale)
        z = x[nf:].reshape(K, 2, nu, nx).transpose(1, 0, 3, 2)
        return values, np.asarray((z[0] + 1j * z[1]) * self.state_scale[:, None])


def programme(free: Free, target: Target, state_scale: Array, *, logarithmic: bool) -> Programme:
    """Build the programme; its start is the guess with zero states until `Programme.pack`.

    Parameters
    ----------
    free : Free
        The parameters to estimate.
    target : Target
        What to fit.
    state_scale : (nx,) array
        Typical sizes of the states' responses to scaled inputs.
    logarithmic : bool
        The cost in ln z, or the one in z - 1.
    """
    nf, K = len(free.index), len(target.omega)
    blocks = [_points(free, target, state_scale, logarithmic=logarithmic)]
    if (ties := _ties(free)) is not None:
        blocks.append(ties)
    n = nf + K * 2 * len(state_scale) * len(target.input_scale)
    lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    scale = free.scale[free.index]
    lower[:nf], upper[:nf] = free.lower[free.index] / scale, free.upper[free.index] / scale
    return Programme(
        problem=assemble(blocks, np.zeros(n), lower, upper), free=free, target=target,
        state_scale=state_scale,
    )  # fmt: skip


def _points(free: Free, target: Target, state_scale: Array, *, logarithmic: bool) -> Block:
    """One frequency: the cost of its pairs and the states' equations."""
    K, ny, nu = target.G.shape
    nx, nf = len(state_scale), len(free.index)
    lam, omega = ca.SX.sym("lam", nf), ca.SX.sym("omega")
    A, B, C, D, tau = _scaled(free, lam, target.input_scale, state_scale)
    Xr, Xi = ca.SX.sym("Xr", nx, nu), ca.SX.sym("Xi", nx, nu)
    # 1/ĝ is data, zero where unused; the offset of one then keeps z away from zero.
    Hr, Hi, weight = (ca.SX.sym(name, ny, nu) for name in ("Hr", "Hi", "weight"))
    offset = weight == 0
    states = ca.vertcat(ca.vec(-omega * Xi - A @ Xr - B), ca.vec(omega * Xr - A @ Xi)) / omega
    gr, gi = C @ Xr + D, C @ Xi
    turn = [ca.repmat(part.T, ny, 1) for part in (ca.cos(omega * tau), ca.sin(omega * tau))]
    zr, zi = gr * Hr - gi * Hi, gr * Hi + gi * Hr
    zr, zi = zr * turn[0] + zi * turn[1] + offset, zi * turn[0] - zr * turn[1]
    if logarithmic:
        gain, phase = ca.log(zr**2 + zi**2 + TINY) / 2, ca.atan2(zi, zr)
    else:
        gain, phase = zr - 1, zi
    cost = ca.sum(ca.vec(weight * (DB**2 * gain**2 + PHASE * DEG**2 * phase**2)))
    used = target.weight > 0
    H = np.where(used, 1 / np.where(used, target.G, 1.0), 0.0) / target.input_scale
    data = np.vstack([target.omega, *map(_columns, (H.real, H.imag, target.weight))])
    n = 2 * nx * nu
    index = np.empty((nf + n, K), dtype=int)
    index[:nf] = np.arange(nf)[:, None]
    index[nf:] = nf + np.arange(K * n).reshape(K, n).T
    zero = np.zeros(2 * nx * nu)
    return Block(
        w=ca.vertcat(lam, ca.vec(Xr), ca.vec(Xi)),
        d=ca.vertcat(omega, ca.vec(Hr), ca.vec(Hi), ca.vec(weight)),
        f=cost, g=states, index=index, data=data, lower=zero, upper=zero,
    )  # fmt: skip


def _columns(M: Array) -> Array:
    """Matrices of all frequencies as columns, in CasADi's order, (ny nu, K)."""
    return M.transpose(0, 2, 1).reshape(len(M), -1).T


def _scaled(free: Free, lam: ca.SX, input_scale: Array, state_scale: Array) -> tuple[ca.SX, ...]:
    """A, B, C, D and τ of scaled states and inputs, symbols of the scaled free parameters."""
    A, B, C, D, tau, _ = free.model.matrices()(free.full(lam * free.scale[free.index]))
    S, U = ca.diag(ca.DM(state_scale)), ca.diag(ca.DM(input_scale))
    inverse = ca.diag(ca.DM(1 / state_scale))
    return inverse @ A @ S, inverse @ B @ U, C @ S, D @ U, tau


def delay_parameters(free: Free) -> tuple[list[int], list[int]]:
    """Free parameters that are a delay themselves, and inputs whose delay is composed of others."""
    lam = ca.SX.sym("lam", len(free.index))
    tau = free.model.matrices()(free.full(lam))[4]
    slope = ca.jacobian(tau, lam)
    bare, composed = [], []
    for j in range(tau.numel()):
        row = slope[j, :]
        which = row.sparsity().get_triplet()[1]
        if len(which) == 1 and row[0, which[0]].is_one():
            bare.append(int(which[0]))
        elif row.nnz():
            composed.append(j)
    return bare, composed


def _ties(free: Free) -> Block | None:
    """The structure's own constraints, and delays composed of parameters at >= 0."""
    lam = ca.SX.sym("lam", len(free.index))
    *_, tau, c = free.model.matrices()(free.full(lam * free.scale[free.index]))
    composed = delay_parameters(free)[1]
    items = free.model.constraints()
    g = ca.vertcat(ca.densify(c), *[tau[j] for j in composed])
    if not g.numel():
        return None
    return Block(
        w=lam, d=ca.SX(0, 1), f=ca.SX(0), g=g,
        index=np.arange(len(free.index))[:, None], data=np.zeros((0, 1)),
        lower=np.array([*(item.lower for item in items), *(0.0 for _ in composed)]),
        upper=np.array([*(item.upper for item in items), *(np.inf for _ in composed)]),
    )  # fmt: skip


def tie_multipliers(free: Free, solution: Solution) -> Array:
    """IPOPT's multipliers of the structure's own constraints, (m,)."""
    first = len(solution.multipliers_g) - len(delay_parameters(free)[1])
    return solution.multipliers_g[first - len(free.model.constraints()) : first]
