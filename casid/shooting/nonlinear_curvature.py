"""`casid.shooting.curvature` of a nonlinear structure.

Along an interval the costate falls back from the multiplier μ of its end by the derivatives of the
steps, p_k = (∂Φ/∂x)ᵀ p_{k+1} + h_xᵀ ρ_k with ρ = R⁻¹ r. With Z = ∂(x, λ)/∂(λ, x_0) the second
derivatives are those of the Hamiltonian (Bryson & Ho, Applied Optimal Control, section 6.3),

    ∫ Zᵀ (pᵀf)_zz Z dt + Σ_k Z_kᵀ (ρ_kᵀh)_zz Z_k,

f and h functions of z = (x, λ), through delayed inputs too. The integral is taken by the
trapezoidal rule over the samples: an approximate Hessian costs an iteration, never the solution.
"""

import numpy as np

from casid.arrays import Array
from casid.intersample import ORDER
from casid.shooting.curvature import Back, Curvature, costates, weighed
from casid.shooting.nonlinear import NonlinearSweep


def hamiltonian(sweep: NonlinearSweep, mu: Array) -> Curvature:
    """Curvature of output error over all intervals; ``mu`` (J, nx) multiplies their end states."""
    e, layout, rho = sweep.e, sweep.layout, weighed(sweep)
    nf, nx, J = e.nf, e.nx, len(layout.count)
    jumps = np.einsum("nc,ncx->nx", rho, sweep.slopes(e.flow.h)[0])
    back: Back = lambda at, p: np.einsum("nij,ni->nj", sweep.by_x[at], p)  # noqa: E731
    weight, last, later, earlier = costates(layout, jumps, mu[layout.node], back)
    weight[layout.start + layout.count - 1] += last  # goes to the sample before the end
    Hll = _kinks(sweep, (later + earlier) / 2)
    Hln, Hnn = np.empty((J, nf, nx)), np.empty((J, nx, nx))
    slopes = np.zeros((J, e.ny, sweep.ns + e.ny))
    for index in sweep.portions():
        sums = np.zeros((len(index), sweep.ns, sweep.ns))
        for first, at, trail in sweep.trails(index):
            n = at.shape[1]
            valid = (np.arange(len(at)) < layout.count[index[:n], None] - first)[..., None]
            S = trail[:-1].transpose(2, 0, 1, 3)
            M, direct = _second(sweep, at.T, S, weight[at.T] * valid, rho[at.T] * valid)
            sums[:n] += S.reshape(n, -1, sweep.ns).transpose(0, 2, 1) @ M
            Hll += direct
            rows = sweep.rows(at, trail[:-1])
            slopes[index[:n]] += np.einsum("nkca,nkc->nca", rows[..., :-1], rows[..., -1] * valid)
        sums += sums.transpose(0, 2, 1).copy()
        Hll += sums[:, :nf, :nf].sum(axis=0)
        Hln[layout.node[index]], Hnn[layout.node[index]] = sums[:, :nf, nf:], sums[:, nf:, nf:]
    gb = np.zeros((len(layout.records), e.ny, e.ny))
    np.add.at(gb, layout.record, slopes[:, :, sweep.ns :])
    gn = np.empty((e.ny, J, nx))
    gn[:, layout.node] = slopes[:, :, nf : sweep.ns].transpose(1, 0, 2)
    gl = slopes[:, :, :nf].sum(axis=0)
    return Curvature(Hll, Hln, Hnn, gl, gb.transpose(1, 0, 2), gn)


def _kinks(sweep: NonlinearSweep, middle: Array) -> Array:
    """Second derivatives (nf, nf) by delays that move kinks of the inputs: p f_u times theirs."""
    e, m = sweep.e, sweep.matrices
    bend, first = np.zeros(e.nu), 0
    by_u = sweep.slopes(e.flow.f)[1]
    pull: Array = np.einsum("nx,nxu->nu", middle, np.where(np.isfinite(by_u), by_u, 0.0))
    for record, held in zip(e.layout.records, e.held(m), strict=True):
        if ORDER[record.hold] == 2:  # kinks, not jumps
            moved = pull[first + held.step, held.channel] * held.jump
            np.add.at(bend, held.channel, moved)
        first += record.N
    return np.asarray((m.tau_lam.T * bend) @ m.tau_lam)


def _second(
    sweep: NonlinearSweep, at: np.ndarray, S: Array, weight: Array, rho: Array
) -> tuple[Array, Array]:
    """Second derivatives of samples (n, K) of weighted f and h.

    Those by the states, times half what moves these, and by the states and λ: (n, K nx, ns). And
    those by λ alone (nf, nf). S (n, K, nx, ns) are the sensitivities of the states.
    """
    (n, K, nx, ns), nf = S.shape, sweep.e.nf
    bend = sweep.e.flow.bend
    xx, x_lam, lam_lam = sweep.second(at.ravel(), weight.reshape(n * K, nx), rho.reshape(n * K, -1))
    M: Array = 0.5 * (xx.reshape(n, K, nx, nx) @ S)
    bend.x_lam.add(M.reshape(n * K, nx, ns), x_lam)
    direct = np.zeros((1, nf, nf))
    bend.lam_lam.add(direct, lam_lam.sum(axis=0)[None])
    return M.reshape(n, K * nx, ns), direct[0]
