import numpy as np
import pytest
from truths.systems import campaign, unstable_plant

from casid.records import standard_deviations
from casid.subspace.fourier import spectra
from casid.subspace.likelihood import parts
from casid.subspace.modal import moved, to_modal
from casid.subspace.pooled_spectra import alike
from casid.subspace.slopes import normal_equations, with_outputs


def test_normal_equations_are_those_of_the_profiled_cost():
    # Gauss-Newton is exact where the start is the truth of noise-free data; elsewhere the gradient
    # is that of the cost, the transients at their best.
    records, plant = campaign(records=2), unstable_plant()
    su, sy = standard_deviations(records)
    data = spectra(records, su, sy, 12.0)
    mask = plant.D != 0
    free, rng = np.argwhere(mask), np.random.default_rng(1)
    weights = [rng.uniform(0.5, 2.0, (len(s.omega), 3)) for s in data]
    truth, groups = to_modal(plant, su, sy, mask), alike(data, weights)

    def cost(modal, step):
        return sum(p.cost.sum() for p in parts(moved(modal, step, free), groups))

    H, gradient = normal_equations(truth, parts(truth, groups), free)
    for _ in range(3):
        d = rng.standard_normal(len(H))
        twice = (cost(truth, 1e-4 * d) + cost(truth, -1e-4 * d)) / 1e-8
        assert d @ H @ d == pytest.approx(twice / 2, rel=1e-5)
    off = moved(truth, 0.05 * rng.standard_normal(len(H)), free)
    _, gradient = normal_equations(off, parts(off, groups), free)
    h = 1e-6 * np.eye(len(H))
    expected = [(cost(off, -step) - cost(off, step)) / 4e-6 for step in h]
    np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-6 * np.abs(gradient).max())


def test_outputs_are_the_least_squares_solution_given_the_states():
    records, plant = campaign(noise=0.05, records=2), unstable_plant()
    su, sy = standard_deviations(records)
    data, mask = spectra(records, su, sy, 12.0), plant.D != 0
    rng = np.random.default_rng(2)
    weights = [rng.uniform(0.5, 2.0, (len(s.omega), 3)) for s in data]
    free = np.argwhere(mask)
    size = plant.nx * (1 + sum(mask.shape)) + len(free)
    off = moved(to_modal(plant, su, sy, mask), 0.1 * rng.standard_normal(size), free)
    known = parts(off, alike(data, weights))
    found = with_outputs(off, known, free)
    np.testing.assert_array_equal(found.lam, off.lam)
    np.testing.assert_array_equal(found.B, off.B)
    for o in range(3):
        columns, right = [], []
        for s, w, part in zip(data, weights, known, strict=True):
            lam, both = np.r_[off.lam, off.lam.conj()], np.vstack([off.B, off.B.conj()])
            r, _, ends, _ = s.pole_factors(lam)
            x = r * (s.U @ both.T) + ends * np.r_[part.delta[0], part.delta[0].conj()]
            one, other = np.split(x, 2, axis=1)  # c one + c* other, of a real mode c one alone
            real = off.lam.imag == 0
            other[:, real] = 0
            rows = np.hstack([one + other, 1j * (one - other)[:, ~real], s.U[:, mask[o]]])
            columns.append(rows * w[:, [o]])
            right.append(s.Y[:, o] * w[:, o])
        A, y = np.vstack(columns), np.concatenate(right)
        theta = np.linalg.lstsq(np.vstack([A.real, A.imag]), np.r_[y.real, y.imag], rcond=None)[0]
        n, k = len(off.lam), int((~real).sum())
        c = theta[:n].astype(complex)
        c[~real] += 1j * theta[n : n + k]
        np.testing.assert_allclose(found.C[o], c, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(found.D[o, mask[o]], theta[n + k :], rtol=1e-6, atol=1e-8)
        np.testing.assert_array_equal(found.D[o, ~mask[o]], 0.0)
