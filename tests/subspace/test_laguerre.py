import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from truths.systems import unstable_plant

from casid.linear import StateSpace
from casid.subspace.laguerre import from_laguerre, laguerre, project_blocks, support

A = 7.0


def project(t, v, a, n, hold="foh"):
    """All projections at once, (N, n, nv)."""
    return next(project_blocks(t, v, a, n, hold, len(t)))[1]


def to_laguerre(system, K, a):
    """Transformed model and gain of a continuous one, paper (6)."""
    A, B, C, D = system.A, system.B, system.C, system.D
    shifted = A - a * np.eye(len(A))
    root = np.sqrt(2 * a)
    N = np.linalg.solve(shifted, K)  # (Â - aI)⁻¹ K̂
    A_o = np.linalg.solve(shifted, A + a * np.eye(len(A)))
    B_o = root * np.linalg.solve(shifted, B)
    C_o = -root * np.linalg.solve(shifted.T, C.T).T
    D_o = D - C @ np.linalg.solve(shifted, B)
    K_o = root * np.linalg.solve((np.eye(len(C)) - C @ N).T, N.T).T
    names = system.inputs, system.outputs, system.states
    return StateSpace(A_o, B_o, C_o, D_o, 1.0, *names), K_o


def kernel_response(s, n, a=A):
    """∫ ℓ_k(τ) exp(-s τ) dτ, the Laguerre filter (3) at s."""
    k = np.arange(n)
    return np.sqrt(2 * a) * (s - a) ** k / (s + a) ** (k + 1)


def test_functions_are_orthonormal():
    A_L, b = laguerre(A, 6)
    # ∫ ℓ ℓᵀ dτ solves A_L P + P A_Lᵀ = -b bᵀ: the identity for an orthonormal family.
    np.testing.assert_allclose(A_L + A_L.T, -np.outer(b, b), atol=1e-12)


@pytest.mark.parametrize("spacing", ["equidistant", "random"])
def test_projection_of_straight_lines_equals_the_closed_form_integral(spacing):
    rng = np.random.default_rng(1)
    steps = np.full(80, 0.05) if spacing == "equidistant" else rng.uniform(0.01, 0.1, 80)
    t = np.concatenate([[0.0], np.cumsum(steps)])
    v = rng.standard_normal((81, 2))
    z = project(t, v, A, 5)
    # A straight line from v0 to v1 over [p, q] integrates against exp(A_L τ) b in closed form.
    A_L, b = laguerre(A, 5)
    expected = np.zeros((5, 2))
    inverse = np.linalg.inv(A_L)
    for k in range(80):
        p, q = t[k], t[k + 1]
        slope = (v[k + 1] - v[k]) / (q - p)
        Ep, Eq = scipy.linalg.expm(A_L * p) @ b, scipy.linalg.expm(A_L * q) @ b
        zero = inverse @ (Eq - Ep)
        first = inverse @ (Eq * (q - p)) - inverse @ zero
        expected += np.outer(zero, v[k]) + np.outer(first, slope)
    np.testing.assert_allclose(z[0], expected, rtol=1e-9, atol=1e-11)


def test_projection_of_steps_is_exact_for_zero_order_hold():
    t = np.array([0.0, 0.3, 0.4, 1.0])
    v = np.array([[1.0], [-2.0], [0.5], [9.0]])  # the last value holds over no interval
    z = project(t, v, A, 4, hold="zoh")
    A_L, b = laguerre(A, 4)
    at = [scipy.linalg.expm(A_L * instant) @ b for instant in t]
    pieces = [np.linalg.solve(A_L, (at[k + 1] - at[k]) * v[k, 0]) for k in range(3)]
    np.testing.assert_allclose(z[0, :, 0], sum(pieces), rtol=1e-10)


def test_projection_of_an_exponential_has_its_textbook_value():
    t = np.linspace(0, 12, 12001)
    z = project(t, np.exp(-0.5 * t)[:, None], A, 6)
    # Linear interpolation of exp(-t/2) at 1 ms is within h²/8/4 = 3e-8 of it.
    np.testing.assert_allclose(z[1000, :, 0], np.exp(-0.5) * kernel_response(0.5, 6), atol=1e-6)


def test_blocks_join_to_the_whole_projection():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.01, 0.03, 300))
    v = rng.standard_normal((300, 3))
    whole = project(t, v, A, 4)
    for start, block in project_blocks(t, v, A, 4, size=64):
        np.testing.assert_array_equal(block, whole[start : start + len(block)])


@pytest.mark.parametrize("k", [0, 4, 9, 19])
def test_support_leaves_one_percent_of_the_norm_outside(k):
    A_L, b = laguerre(1.0, k + 1)
    t = np.linspace(0, 2 * support(1.0, k), 40001)
    step = scipy.linalg.expm(A_L * t[1])
    values, state = np.empty(len(t)), b.copy()
    for i in range(len(t)):
        values[i] = state[-1]
        state = step @ state
    tail = np.trapezoid(np.where(t > support(1.0, k), values, 0.0) ** 2, t)
    assert np.sqrt(tail) < 0.012


@pytest.mark.second
@given(seed=st.integers(0, 10_000), a=st.floats(3.0, 30.0))
def test_bilinear_maps_invert_each_other(seed, a):
    rng = np.random.default_rng(seed)
    n, nu, ny = 4, 2, 3
    system = StateSpace(
        rng.uniform(-2, 2, (n, n)) - np.eye(n),
        rng.standard_normal((n, nu)),
        rng.standard_normal((ny, n)),
        rng.standard_normal((ny, nu)),
    )
    K = 0.3 * rng.standard_normal((n, ny))
    back, K_back = from_laguerre(*to_laguerre(system, K, a), a)
    for letter in "ABCD":
        got, want = getattr(back, letter), getattr(system, letter)
        # The maps amplify rounding by the conditioning of A - aI and of the gain's inverse.
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(K_back, K, rtol=1e-8, atol=1e-8)


def test_bilinear_round_trip_is_exact_to_rounding_for_a_well_conditioned_plant():
    plant = unstable_plant()
    K = np.array([[0.4, 0, 0], [0, 0.8, 0], [0, 0, 1.0], [0.2, 0, 0], [0, 0, 0.5]])
    back, K_back = from_laguerre(*to_laguerre(plant, K, 10.0), 10.0)
    for letter in "ABCD":
        np.testing.assert_allclose(getattr(back, letter), getattr(plant, letter), atol=1e-12)
    np.testing.assert_allclose(K_back, K, atol=1e-12)


def test_transformed_innovation_model_is_the_continuous_one_at_the_mapped_frequency():
    plant, a = unstable_plant(), 10.0
    K = np.array([[0.4, 0, 0], [0, 0.8, 0], [0, 0, 1.0], [0.2, 0, 0], [0, 0, 0.5]])
    transformed, K_o = to_laguerre(plant, K, a)
    s = 2.0j
    z = (s + a) / (s - a)
    eye = np.eye(plant.nx)
    G = plant.C @ np.linalg.solve(s * eye - plant.A, plant.B) + plant.D
    G_o = transformed.C @ np.linalg.solve(z * eye - transformed.A, transformed.B) + transformed.D
    np.testing.assert_allclose(G_o, G, rtol=1e-12)
    # Innovations: H_o(z) = H(s) H(a)⁻¹ for the gain with its factors in the order that multiplies.
    H = lambda s: np.eye(3) + plant.C @ np.linalg.solve(s * eye - plant.A, K)  # noqa: E731
    H_o = np.eye(3) + transformed.C @ np.linalg.solve(z * eye - transformed.A, K_o)
    np.testing.assert_allclose(H_o, H(s) @ np.linalg.inv(H(a)), rtol=1e-11, atol=1e-12)


def test_a_transformed_pole_at_one_is_refused():
    system = StateSpace(np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), 1.0)
    with pytest.raises(ValueError, match="lower the order or raise the Laguerre pole"):
        from_laguerre(system, np.zeros((1, 1)), 5.0)
