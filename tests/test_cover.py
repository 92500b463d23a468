"""Weights that cover: never violated, tight, and refused where they would mean nothing."""

import control
import numpy as np
import pytest
import scipy

from casid import StateSpace, cover
from casid.cover import _peaks, _resonances


def ensemble(rng, spread=0.1, count=20):
    """A stable system with three outputs and two inputs, and its relatives."""
    n = rng.integers(2, 6)
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.2, 1)) * np.eye(n)
    B, C, D = rng.standard_normal((n, 2)), rng.standard_normal((3, n)), np.zeros((3, 2))
    drawn = [
        StateSpace(A * (1 + spread * rng.standard_normal(A.shape)), B, C, D) for _ in range(count)
    ]
    return StateSpace(A, B, C, D), [each for each in drawn if each.poles().real.max() < 0]


def error(nominal, models, omega, kind):
    """Largest singular value of the difference, by python-control's responses."""

    def response(system):
        plain = control.ss(system.A, system.B, system.C, system.D)
        return np.moveaxis(plain(1j * omega), 2, 0)

    G0 = response(nominal)
    right = np.linalg.pinv(G0) if kind == "multiplicative" else np.eye(2)
    apart = [(response(m) - G0) @ right for m in models]
    return np.max(np.linalg.svd(np.array(apart), compute_uv=False)[..., 0], axis=0)


def violated(rng, kind):
    """Least and mean ratio of a weight to the error between and beside its own points."""
    nominal, models = ensemble(rng)
    found = cover(nominal, models, band=(0.1, 30.0), order=4, kind=kind)
    assert found.weight.poles().real.max() < 0
    omega = np.geomspace(0.1, 30.0, 3001)
    W = np.abs(found.weight.response(omega)[:, 0, 0])
    ratio = W / np.maximum(error(nominal, models, omega, kind), 1e-6 * W)
    return ratio.min(), np.exp(np.mean(np.log(ratio)))


@pytest.mark.campaign
@pytest.mark.parametrize(
    "kind", [pytest.param("additive", marks=pytest.mark.campaign), "multiplicative"]
)
def test_a_weight_covers_between_its_points_and_is_tight(kind):
    found = np.array([violated(np.random.default_rng(seed), kind) for seed in (3, 8)])
    assert found[:, 0].min() > 1 - 1e-4  # 400 points a decade: what curvature leaves between two
    assert found[:, 1].mean() < 1.5


@pytest.mark.campaign
def test_no_weight_of_two_hundred_is_violated():
    rng = np.random.default_rng(20)
    kinds = ("additive", "multiplicative")
    found = np.array([violated(rng, kind) for _ in range(100) for kind in kinds])
    assert found[:, 0].min() > 1 - 1e-4
    assert found[:, 1].mean() < 1.5


def phugoids(damping, seed):
    """A lightly damped mode beside a fast one, and relatives whose frequency and damping vary."""
    rng = np.random.default_rng(seed)

    def plane(frequency, damping, stiffness):
        slow = [[0, 1], [-(frequency**2), -2 * damping * frequency]]
        fast = [[0, 1], [-9 * stiffness, -3 * stiffness]]
        B = [[0], [0.1], [0], [9 * stiffness]]
        return StateSpace(scipy.linalg.block_diag(slow, fast), B, [[0, 1, 0, 1]], [[0]])

    drawn = rng.standard_normal((3, 10))
    drawn = 1 + np.array([[0.03], [0.3], [0.1]]) * np.clip(drawn, -2, 2)
    return plane(0.45, damping, 1), [plane(0.45 * a, damping * b, c) for a, b, c in drawn.T]


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize(
    ("damping", "order"),
    [
        (0.04, 6),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0.04, 5), (0.02, 4))),
        *(pytest.param(*each, marks=pytest.mark.campaign) for each in ((0.005, 6), (1e-5, 2))),
    ],
)
def test_a_weight_of_light_damping_is_stable_of_minimum_phase_and_covers(damping, order):
    nominal, models = phugoids(damping, seed=order)
    W = cover(nominal, models, band=(0.3, 12.0), order=order).weight
    # Roots by python-control; errors beside every root and resonance by their definition.
    plain = control.ss(W.A, W.B, W.C, W.D)
    roots = np.concatenate([plain.poles(), plain.zeros()])
    assert roots.real.max() < 0
    every = np.concatenate([roots, *(model.poles() for model in (nominal, *models))])
    every = every[every.imag > 0]
    beside = every.imag[:, None] + np.abs(every.real)[:, None] * np.linspace(-3, 3, 61)
    omega = np.concatenate([np.geomspace(0.3, 12.0, 3000), beside.ravel()])
    omega = np.sort(omega[(omega > 0.3) & (omega < 12.0)])
    apart = np.max([np.abs(of(m, omega) - of(nominal, omega)) for m in models], axis=0)
    assert (np.abs(of(W, omega)) / apart).min() > 1 - 1e-6


@pytest.mark.second
def test_a_weight_too_low_of_order_says_how_large_it_is_and_which_would_do():
    # One model whose resonance is elsewhere: two peaks, which two states cannot follow.
    def mode(frequency):
        A = [[0, 1], [-(frequency**2), -0.04 * frequency]]
        return StateSpace(A, [[0], [1]], [[1, 0]], [[0]])

    low, enough = (cover(mode(2), [mode(5)], band=(0.3, 12.0), order=order) for order in (2, 4))
    assert low.excess > 1.5 >= enough.excess
    assert (low.enough, enough.enough) == (4, 4)
    assert "an order of 4 makes that at most 1.5" in repr(low)
    assert "makes" not in repr(enough)


@pytest.mark.campaign
def test_modes_that_no_order_follows_are_told_and_the_excess_is_that_of_a_dense_grid():
    rng = np.random.default_rng(4711)

    def three(w, damping, gain):
        A = scipy.linalg.block_diag(
            *([[0, 1], [-a * a, -2 * d * a]] for a, d in zip(w, damping, strict=True))
        )
        return StateSpace(A, np.kron(gain * w**2, [0, 1])[:, None], [[1, 0] * 3], [[0]])

    for _ in range(2):  # the second draw: 2.1 at order 10
        w, gain = np.sort(rng.uniform(0.6, 10, 3)), rng.uniform(0.5, 2, 3)
        nominal, models = three(w, [0.003] * 3, gain), []
        for _ in range(4):
            a, b, c = rng.standard_normal((3, 3))
            damping = 0.003 * (1 + 0.3 * np.clip(b, -2, 2))
            models.append(three(w * (1 + 0.03 * a), damping, gain * (1 + 0.1 * c)))
    found = cover(nominal, models, band=(0.3, 20.0), order=4)
    assert found.enough is None
    assert "no order up to 10 makes that at most 1.5" in found.headline()
    roots = np.concatenate([each.poles() for each in (nominal, found.weight, *models)])
    beside = np.abs(roots.real)[:, None] * np.sinh(np.linspace(-8, 8, 2001))
    omega = np.concatenate([np.geomspace(0.3, 20, 30001), (roots.imag[:, None] + beside).ravel()])
    omega = np.unique(omega[(omega >= 0.3) & (omega <= 20)])
    apart = np.max([np.abs(of(m, omega) - of(nominal, omega)) for m in models], axis=0)
    ratio = np.log(np.abs(of(found.weight, omega)) / apart)
    mean = np.trapezoid(ratio, np.log(omega)) / np.log(20 / 0.3)
    assert ratio.min() > -1e-6
    assert found.excess == pytest.approx(np.exp(mean), rel=5e-3)  # 400 points a decade


def of(system, omega):
    """The response of one channel by its definition."""
    A = 1j * omega[:, None, None] * np.eye(system.nx) - system.A
    return (system.C @ np.linalg.solve(A, system.B + 0j * A[:, :, :1]) + system.D)[:, 0, 0]


def test_poles_on_the_axis_in_the_band_are_refused_and_integrators_below_it_covered():
    def mode(damping, gain=1.0):
        return StateSpace([[0, 1], [-9, -6 * damping]], [[0], [gain]], [[1, 0]], [[0]])

    for nominal, model, name in ((mode(0), mode(0.1), "nominal"), (mode(0.1), mode(0), "model 1")):
        with pytest.raises(ValueError, match=f"{name}.* imaginary axis at 3 rad/s, in the band"):
            cover(nominal, [model], band=(0.3, 12.0))
    # Of double integrators the difference is 0.2/s², a lag of order two at best.
    double = [StateSpace([[0, 1], [0, 0]], [[0], [gain]], [[1, 0]], [[0]]) for gain in (1.0, 1.2)]
    found = cover(double[0], double[1:], band=(0.3, 12.0), order=2)
    np.testing.assert_allclose(found.error, 0.2 / found.omega**2, rtol=1e-9)
    assert 1 <= found.margin <= found.excess < 1.3


@pytest.mark.second
def test_a_lag_that_varies_in_gain_is_covered_by_itself():
    # G - G_0 = (k - 1)/(s + 2), largest at k = 1.3: W = 0.3/(s + 2) fits with order one.
    def lag(gain):
        return StateSpace([[-2.0]], [[gain]], [[1.0]], [[0.0]])

    found = cover(lag(1.0), [lag(0.8), lag(1.3)], band=(0.1, 20.0), order=1)
    assert found.excess == pytest.approx(1.0, abs=2e-3)
    assert found.weight.poles()[0].real == pytest.approx(-2.0, rel=0.05)
    flat = cover(lag(1.0), [lag(1.3)], band=(0.1, 20.0), order=2, kind="multiplicative")
    assert np.abs(flat.weight.response([1.0])[0, 0, 0]) == pytest.approx(0.3, rel=2e-3)
    scaled = cover(lag(1.0), [lag(1.3)], band=(0.1, 20.0), order=1, scale=([10.0], [0.5]))
    np.testing.assert_allclose(scaled.error, 20 * found.error, rtol=1e-9)


def test_what_no_weight_can_cover_is_refused():
    stable = StateSpace([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]])
    growing = StateSpace([[0.5]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]])
    band = (0.1, 10.0)
    for wrong, match in (
        ({"models": [growing]}, "model 1 has 1 unstable poles, the nominal one 0"),
        ({"models": []}, "no models given to cover"),
        ({"models": [stable]}, "all models equal the nominal one"),
        ({"models": [StateSpace([[-1.0]], [[0.3, 0.3]], [[1 / 0.3]], np.zeros((1, 2)))]}, "equal"),
        ({"models": [stable], "kind": "multiplicative"}, "as many outputs as inputs"),
        ({"models": [stable], "kind": "input"}, 'expected "additive" or "multiplicative"'),
        ({"models": [stable], "scale": ([1.0, 0.0], [1.0])}, "finite sizes above 0"),
        ({"models": [stable], "scale": ([1.0, 1.0], [-1.0])}, "finite sizes above 0"),
        ({"models": [stable], "scale": ([1.0], [1.0])}, "sizes of 2 inputs and of 1 output"),
        ({"models": [stable], "order": 0}, "order=0: expected 1 to 10"),
        ({"models": [stable], "band": (2.0, 1.0)}, "0 <= lowest < highest"),
    ):
        with pytest.raises(ValueError, match=match):
            cover(stable, **({"band": band} | wrong))


@pytest.mark.parametrize("gain", [0.0, 1.0])
def test_a_direction_to_which_the_nominal_model_does_not_answer_is_refused(gain):
    # With rows (1, k) and (0, 0) both inputs do the same; without k the second does nothing.
    def two(first, second):
        B = [[1.0, gain], [0.0, first]] if second is None else [[1.0, 0.0], [0.0, second]]
        names = {"inputs": ("lat", "ped"), "outputs": ("p", "r")}
        return StateSpace(-np.diag([1.0, 2.0]), B, np.eye(2), np.zeros((2, 2)), **names)

    how = {"band": (0.1, 10.0), "kind": "multiplicative", "order": 1}
    named = "lat and ped on their own" if gain else "answer to ped on"
    with pytest.raises(ValueError, match=rf"{named}.* at 0.1 to 10 rad/s.*additive"):
        cover(two(0.0, None), [two(1.0, None)], **how)
    assert cover(two(0.0, 0.5), [two(0.0, 0.6)], **how).error.max() == pytest.approx(0.2)


def test_a_band_without_end_is_refused():
    lag = StateSpace([[-2.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(ValueError, match="finite"):
        cover(lag, [lag], band=(0.1, np.inf))


def test_errors_are_looked_at_beside_lightly_damped_roots_within_the_band():
    roots = np.array([-0.02 + 2j, -0.02 - 2j, -1 + 1j, -0.01 + 30j])
    at = _resonances(roots, 0.5, 20.0)
    assert (at.min(), at.max()) == pytest.approx((1.92, 2.08))
    assert np.abs(at - 2.0).min() < 1e-12


def test_a_flat_top_is_looked_at_over_all_its_length():
    omega = np.array([1.0, 2.0, 4.0, 5.0, 7.0])
    at = _peaks(omega, np.array([0.5, 0.9, 0.9, 0.5, 0.4]))
    assert (at.min(), at.max()) == (1.0, 5.0)
    assert np.diff(np.unique(at)).max() <= 0.15 * (1 + 1e-9)  # a twentieth of 3 rad/s
