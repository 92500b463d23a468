"""What Gauss-Newton leaves out of the Hessian: the curvature of outputs and end states.

Along the simulation of an interval the costate p(t) falls back from the multiplier μ of its end,

    -dp/dt = Aᵀ p,    p(t_k⁻) = p(t_k⁺) + Cᵀ ρ_k,    ρ = R⁻¹ r,

and with the sensitivities S = ∂x/∂(λ, x_0) the second derivatives of ρᵀ(C x + D u) and μᵀ x_end
against λ_a and any unknown are those of the Hamiltonian (Bryson & Ho, Applied Optimal Control,
section 6.3)

    ∫ pᵀ (∂A/∂λ_a) S dt + Σ_k ρ_kᵀ (∂C/∂λ_a) S_k,    transposed too for two λ,

and of the delayed inputs. The integral is taken by the trapezoidal rule and the matrices as affine
in λ: an approximate Hessian costs an iteration, never the solution.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from casid.arrays import Array
from casid.assembly import by_number
from casid.shooting.convolution import convolved
from casid.shooting.intervals import Layout
from casid.shooting.sensitivity import Sweep, counts

Back: TypeAlias = Callable[[np.ndarray, Array], Array]  # costates one step before samples


@dataclass(frozen=True, eq=False)
class Curvature:
    """Second derivatives, and each channel's share of the cost's gradient, in physical units.

    The gradients are those of ½ Σ r²/R; J intervals stand in chronological order.
    """

    Hll: Array  # (nf, nf) by the parameters
    Hln: Array  # (J, nf, nx) by the parameters and the node of every interval
    Hnn: Array  # (J, nx, nx) by the nodes: zero of a linear structure
    gl: Array  # (ny, nf) gradient by the parameters
    gb: Array  # (ny, records, ny) by the biases
    gn: Array  # (ny, J, nx) by the nodes


def curvature(sweep: Sweep, mu: Array) -> Curvature:
    """Curvature of output error over all intervals; ``mu`` (J, nx) multiplies their end states."""
    e, layout, motion, m = sweep.e, sweep.layout, sweep.motion, sweep.matrices
    rho = weighed(sweep)
    back: Back = lambda at, p: sweep.steps.back(layout.step[at], p)  # noqa: E731
    weight, last, after, _ = costates(layout, rho @ m.C, mu[layout.node], back)
    shared, weights = convolved(sweep), np.hstack([weight, rho])
    found = _moments(sweep, weights, last) if shared is None else shared.moments(weights, last)
    total, at_nodes = found
    by_lam = np.concatenate([m.A_lam, m.C_lam])
    Hll = np.einsum("vms,vma->sa", total, by_lam) + _delayed(sweep, after, rho)
    Hln, gn = np.empty((len(last), e.nf, e.nx)), np.empty((e.ny, len(last), e.nx))
    Hln[layout.node] = np.einsum("jvms,vma->jas", at_nodes, by_lam, optimize=True)
    gn[:, layout.node] = np.einsum("jcms,cm->cjs", at_nodes[:, e.nx :], m.C)
    through = np.hstack([rho.T @ motion.states, rho.T @ sweep.steps.inputs])
    gl = np.einsum("cms,cm->cs", total[e.nx :], m.C)
    gl += np.einsum("cm,cma->ca", through, sweep.drive)
    edges = np.cumsum([0, *(record.N for record in layout.records)])[:-1]
    gb = np.add.reduceat(rho, edges, axis=0).T[:, :, None] * np.eye(e.ny)[:, None, :]
    Hnn = np.zeros((len(last), e.nx, e.nx))
    return Curvature(Hll + Hll.T, Hln, Hnn, gl, gb, gn)


def weighed(sweep: Sweep) -> Array:
    """R⁻¹ r of all samples, (N, ny); zero where an output is missing."""
    r = sweep.motion.residuals
    rho = np.empty_like(r)
    for p, mine in by_number(sweep.layout.pattern, len(sweep.W)):
        rho[mine] = r[mine] @ (sweep.W[p].T @ sweep.W[p])
    return rho


def costates(
    layout: Layout, jumps: Array, mu: Array, back: Back
) -> tuple[Array, Array, Array, Array]:
    """Costates weighted for the trapezoidal rule at all samples (N, nx) and at the ends (J, nx).

    The others, (N, nx), are unweighted: one step after every sample, and from there ``back`` at it,
    before its jump. The rule takes the costate before a sample's jump for the step that ends there
    and the one after it for the step that begins; the last step of an interval ends at its end
    state.
    """
    half = layout.classes[layout.step][:, None] / 2
    weight, later, p = np.zeros_like(jumps), np.empty_like(jumps), mu.copy()
    earlier = np.empty_like(jumps)
    many = counts(layout.count)
    for k in range(len(many) - 1, -1, -1):
        at = layout.start[: many[k]] + k
        after = many[k + 1] if k + 1 < len(many) else 0
        weight[at[:after] + 1] += half[at[:after]] * p[:after]
        later[at] = p[: many[k]]
        earlier[at] = back(at, p[: many[k]])
        weight[at] += half[at] * earlier[at]
        p[: many[k]] = earlier[at] + jumps[at]
    return weight, half[layout.start + layout.count - 1] * mu, later, earlier


def _moments(sweep: Sweep, weight: Array, last: Array) -> tuple[Array, Array]:
    """Σ_k weight_k ⊗ S_k over all samples (N, nv) and the end, whose weights are the first nx.

    By the parameters over all intervals (nv, nx, nf), by its node for each (J, nv, nx, nx).
    """
    e, nf, nx, nv = sweep.e, sweep.e.nf, sweep.e.nx, weight.shape[1]
    total, at_nodes = np.zeros((nv, nx, nf)), np.zeros((len(last), nv, nx, nx))
    for index in sweep.portions():
        sums = np.zeros((len(index), nv, nx * sweep.ns))
        for first, at, trail in sweep.trails(index):
            (K, n), count = at.shape, e.layout.count[index[: at.shape[1]]] - first
            V = np.zeros((K + 1, n, nv))
            V[:-1] = weight[at] * (np.arange(K)[:, None] < count)[:, :, None]
            ending = np.flatnonzero(count <= K)
            V[count[ending], ending, :nx] += last[index[ending]]
            S = trail.transpose(2, 0, 1, 3).reshape(n, K + 1, -1)
            sums[:n] += V.transpose(1, 2, 0) @ S
        shaped = sums.reshape(len(index), nv, nx, sweep.ns)
        total += shaped[:, :, :, :nf].sum(axis=0)
        at_nodes[index] = shaped[:, :, :, nf:]
    return total, at_nodes


def _delayed(sweep: Sweep, after: Array, rho: Array) -> Array:
    """Half the second derivatives through delayed inputs; ``after`` (N, nx): costates a step on."""
    m, nu = sweep.matrices, sweep.e.nu
    bend, mixed = sweep.steps.delay_moments(after)
    through = np.einsum("im,ima->ma", mixed, m.B_lam)
    through -= np.einsum("cm,cma->ma", rho.T @ sweep.steps.inputs[:, nu:], m.D_lam)
    return np.asarray((through + bend[:, None] / 2 * m.tau_lam).T @ m.tau_lam)
