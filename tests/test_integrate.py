"""One-step maps against closed forms, quadrature and finite differences."""

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from casid.linear import foh_step
from casid.shooting.integrate import step_map, step_slopes

A = np.array([[-0.4, 2.0, 0.3], [-1.0, -3.0, 0.0], [0.5, 1.0, 0.2]])
B = np.array([[1.0, 0.0], [0.5, 2.0], [0.0, -1.0]])
K = np.array([[0.3], [1.0], [-0.2]])
H = 0.05


def test_a_lag_has_its_textbook_maps():
    a = -2.0
    m = step_map(np.array([[a]]), np.array([[3.0]]), np.zeros((1, 0)), H, "foh")
    e = np.exp(a * H)
    ramp = (e - 1 - a * H) / (a**2 * H)  # ∫ e^{a(h-s)} s/h ds
    np.testing.assert_allclose(m.Ad, [[e]], rtol=1e-14)
    np.testing.assert_allclose(m.B1, [[3.0 * ramp]], rtol=1e-12)
    np.testing.assert_allclose(m.B0, [[3.0 * ((e - 1) / a - ramp)]], rtol=1e-12)


def test_first_order_hold_agrees_with_the_state_space_step():
    m = step_map(A, B, K, H, "foh")
    for mine, other in zip((m.Ad, m.B0, m.B1), foh_step(A, B, H), strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-15)


def test_innovations_and_zero_order_inputs_rest_over_the_step():
    m = step_map(A, B, K, H, "zoh")
    held = scipy.integrate.quad_vec(lambda s: scipy.linalg.expm(A * s), 0, H)[0]
    np.testing.assert_allclose(m.B0, held @ B, atol=1e-13)
    np.testing.assert_allclose(m.Kd, held @ K, atol=1e-13)
    assert not m.B1.any()


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_derivatives_agree_with_central_differences(hold):
    rng = np.random.default_rng(0)
    slopes = tuple(rng.standard_normal((*M.shape, 2)) for M in (A, B, K))
    found = step_slopes(A, B, K, H, hold, slopes)
    eps = 1e-6
    for i in range(2):
        moved = [
            step_map(*(M + s * eps * dM[:, :, i] for M, dM in zip((A, B, K), slopes, strict=True)),
                     H, hold)
            for s in (1, -1)
        ]  # fmt: skip
        for name in ("Ad", "B0", "B1", "Kd"):
            difference = (getattr(moved[0], name) - getattr(moved[1], name)) / (2 * eps)
            # Rounding 1e-16 over a difference of 1e-6, and a truncation of eps².
            np.testing.assert_allclose(getattr(found, name)[:, :, i], difference, atol=2e-9)
