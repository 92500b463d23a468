"""Low-order equivalent systems against systems of that order."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
import scipy
from truths import uh60

from casid import FrequencyResponse, frequency_response
from casid.baseline.loes import transfer_function
from casid.errors import DataWarning
from casid.matching.mismatch import DEG, coherence_weight

OMEGA = np.geomspace(0.3, 15.0, 20)


def measured(function, *, omega=OMEGA, noise=0.0, rng=None, coherence=1.0):
    G = np.asarray(function(1j * omega), dtype=complex)
    if noise:
        G = G * np.exp(noise * (rng.standard_normal(len(G)) + 1j * rng.standard_normal(len(G))))
    shape = (len(omega), 1, 1)
    return FrequencyResponse(
        omega=omega, G=G.reshape(shape), coherence=np.full(shape, coherence),
        random_error=np.full(shape, noise), inputs=("lat",), outputs=("p",),
        input_std=np.ones(1), output_std=np.ones(1),
    )  # fmt: skip


def second_order(s):
    return 12 * (s + 0.5) / (s**2 + 3 * s + 8) * np.exp(-0.07 * s)


def unstable(s):
    return -0.3 * (s + 2) / ((s**2 - 0.2 * s + 0.3) * (s + 4)) * np.exp(-0.15 * s)


def test_a_system_of_the_order_is_found_exactly():
    fit = transfer_function(measured(second_order), (1, 2))
    # Noise-free: what is left is the optimiser's tolerance on J, of the order of its square root.
    np.testing.assert_allclose(fit.numerator, [12, 6], rtol=1e-6)
    np.testing.assert_allclose(fit.denominator, [1, 3, 8], rtol=1e-6)
    assert fit.delay == pytest.approx(0.07, abs=1e-7)
    assert fit.J < 1e-10


def test_an_unstable_system_of_negative_gain_is_found_too():
    fit = transfer_function(measured(unstable), (1, 3))
    assert sorted(fit.poles.real) == pytest.approx([-4, 0.1, 0.1], rel=1e-5)
    assert fit.zeros == pytest.approx([-2], rel=1e-5)
    assert fit.delay == pytest.approx(0.15, abs=1e-6)


def test_a_delay_that_zeros_hide_in_the_phase_is_found():
    # They rise by as much as the delay falls: the phase moves through half a radian alone.
    fit = transfer_function(measured(lambda s: (1 + s / 2) ** 4 * np.exp(-0.7 * s)), (4, 0))
    assert fit.delay == pytest.approx(0.7, abs=1e-5)
    assert fit.J < 1e-8


@pytest.mark.parametrize("turned", [0.5, 5.0, 9.0, 15.0])  # rad at the fastest point
@pytest.mark.parametrize(("numerator", "denominator"), [
    ([10.0], [1.0, 2.5]), ([-40.0], [1.0, 2.0, 16.0]), ([30.0, 60.0], [1.0, 4.0, 9.0]),
])  # fmt: skip
def test_delays_of_more_than_a_turn_are_found_exactly(numerator, denominator, turned):
    omega = np.geomspace(0.3, 15.0, 40)
    tau = turned / omega[-1]
    frf = measured(lambda s: np.polyval(numerator, s) / np.polyval(denominator, s)
                   * np.exp(-tau * s), omega=omega)  # fmt: skip
    fit = transfer_function(frf, (len(numerator) - 1, len(denominator) - 1))
    assert fit.delay == pytest.approx(tau, rel=1e-6)
    np.testing.assert_allclose(fit.numerator, numerator, rtol=1e-5)
    np.testing.assert_allclose(fit.denominator, denominator, rtol=1e-5)


@pytest.mark.second
def test_no_delay_fits_a_higher_order_better():
    # The best K and a of K e^(-τs)/(s + a) for every delay, from several a each; K is closed.
    omega = np.geomspace(0.3, 15.0, 40)
    s = 1j * omega
    late = 500 / ((s + 2.5) * (s**2 + 10 * s + 50) * (1 + s / 8) * (1 + s / 12)) * np.exp(-0.1 * s)
    weight = 20 / len(omega) * coherence_weight(np.array(1.0))

    def cost(log_a, tau):
        ratio = np.exp(-tau * s) / (s + np.exp(log_a)) / late
        gain, phase = 20 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
        return weight * np.sum((gain - gain.mean()) ** 2 + 0.01745 * phase**2)

    grid = np.meshgrid(np.linspace(-3, 3, 61), np.linspace(0, 1.5, 151))
    log_a, tau = (each.ravel() for each in grid)
    coarse = [cost(*at) for at in zip(log_a, tau, strict=True)]
    k = int(np.argmin(coarse))
    start = [log_a[k], tau[k]]
    exact = scipy.optimize.minimize(lambda x: cost(*x), start, method="Nelder-Mead", tol=1e-10)
    fit = transfer_function(measured(lambda _: late, omega=omega), (0, 1))
    assert pytest.approx(exact.fun, rel=1e-8) == fit.J
    assert fit.delay == pytest.approx(exact.x[1], rel=1e-4)


def test_without_delay_none_is_estimated():
    fit = transfer_function(measured(lambda s: 3 / (s + 2)), (0, 1), delay=False)
    assert fit.delay == 0.0
    assert fit.poles == pytest.approx([-2])
    late = transfer_function(measured(lambda s: 3 / (s + 2) * np.exp(-0.2 * s)), (0, 1),
                             delay=False)  # fmt: skip
    assert late.J > 100


def test_a_delay_never_turns_negative():
    fit = transfer_function(measured(lambda s: (0.1 * s + 1) / (s + 1)), (0, 1))
    assert fit.delay >= 0
    assert np.isnan(fit.std_error[-1])


def test_the_cost_is_that_of_the_definition():
    # A gain wrong by 1 dB and a phase wrong by 10 degrees at every point, which no order-0 fit of
    # gain alone can remove: J = 20 W_γ 0.01745 Δφ².
    fit = transfer_function(
        measured(lambda s: np.full(s.shape, np.exp(1j * 10 / DEG)), coherence=0.8),
        (0, 0), delay=False,
    )  # fmt: skip
    weight = coherence_weight(np.array(0.8))
    assert weight == pytest.approx((1.58 * (1 - np.exp(-0.8))) ** 2)
    assert pytest.approx(20 * weight * 0.01745 * 100, rel=1e-9) == fit.J
    np.testing.assert_allclose(np.abs(fit.mismatch_deg), 10, rtol=1e-9)
    np.testing.assert_allclose(fit.mismatch_db, 0, atol=1e-9)


def test_the_fit_does_not_depend_on_units():
    base = transfer_function(measured(second_order), (1, 2))
    fast = transfer_function(measured(lambda s: 1e3 * second_order(s / 50), omega=50 * OMEGA),
                             (1, 2))  # fmt: skip
    np.testing.assert_allclose(fast.poles, 50 * base.poles, rtol=1e-5)
    assert fast.delay == pytest.approx(base.delay / 50, rel=1e-4)


@pytest.mark.campaign
def test_stated_errors_scale_with_the_scatter():
    rng = np.random.default_rng(1)
    noise = 0.03
    fits = [transfer_function(measured(second_order, noise=noise, rng=rng), (1, 2))
            for _ in range(60)]  # fmt: skip
    poles = np.std([np.abs(fit.poles[0]) for fit in fits])
    assert poles < 0.1 * np.sqrt(8)
    values = np.array([[*fit.numerator, *fit.denominator[1:], fit.delay] for fit in fits])
    ratio = np.std(values, axis=0) / np.mean([fit.std_error for fit in fits], axis=0)
    # J counts dB² and degrees² as they are: a noise of ε nepers is worth 8.7 ε in gain and 7.6 ε in
    # phase. With H = 2 JᵀJ the scatter is √2 of that times √(H⁻¹)ᵢᵢ; 60 runs know it to 10 %.
    np.testing.assert_allclose(ratio, np.sqrt(2) * 8.2 * noise, rtol=0.35)


def lag(s):
    return 12 / (s + 4) * np.exp(-0.08 * s)


def exact_errors(fit, omega, coherence):
    """√(H⁻¹)ᵢᵢ in rational arithmetic, from the definition of J and derivatives of ln G."""
    s, (nz, n) = 1j * omega, (len(fit.numerator) - 1, len(fit.denominator) - 1)
    columns = [s**k / np.polyval(fit.numerator, s) for k in range(nz, -1, -1)]
    columns += [-(s**k) / np.polyval(fit.denominator, s) for k in range(n - 1, -1, -1)]
    slopes = np.column_stack([*columns, -s])
    weight = 20 / len(omega) * (1.58 * (1 - np.exp(-coherence))) ** 2
    rows = np.vstack([20 / np.log(10) * slopes.real, 0.01745**0.5 * 180 / np.pi * slopes.imag])
    rows = [[Fraction(float(entry)) for entry in row] for row in np.sqrt(weight) * rows]
    size = range(len(rows[0]))
    H = [[2 * sum(row[i] * row[j] for row in rows) for j in size] for i in size]
    M = [[*H[i], *(Fraction(i == j) for j in size)] for i in size]
    for i in size:  # Gauss and Jordan
        M[i] = [entry / M[i][i] for entry in M[i]]
        for k in size:
            if k != i:
                M[k] = [a - M[k][i] * b for a, b in zip(M[k], M[i], strict=True)]
    return np.array([float(M[i][len(size) + i]) ** 0.5 for i in size])


@pytest.mark.parametrize("order", [(0, 1), (0, 2)])
def test_stated_errors_are_those_of_the_definition_where_little_is_determined_too(order):
    # A first-order system's second pole leaves for infinity, where nothing tells it from the gain.
    rng, omega = np.random.default_rng(0), np.geomspace(0.8, 15, 20)
    noise = 0.02 * (rng.standard_normal(20) + 1j * rng.standard_normal(20))
    frf = measured(lambda s: lag(s) * (1 + noise), omega=omega, coherence=0.95)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", DataWarning)
        fit = transfer_function(frf, order)
    assert [str(each.message) for each in told] == [
        "transfer function of order (0, 2) for p/lat: the measurement does not determine b_0, a_1, "
        "a_2, the delay; lower the order"
    ] * (order == (0, 2))
    # Rounding of 1e-16 in J is up to 1e-16 times the error's ratio of 1e11 in its inverse.
    np.testing.assert_allclose(fit.std_error, exact_errors(fit, omega, 0.95), rtol=1e-3)
    if order == (0, 2):
        assert (fit.std_error[:3] > 1e6 * np.abs([*fit.numerator, *fit.denominator[1:]])).all()


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("order", [(1, 1), (0, 2), (1, 2), (1, 3), (2, 3)])
def test_an_order_above_the_system_s_fits_as_well_as_its_own(order):
    # Without noise its own order has J = 0, and what more there is wanders without an end.
    with pytest.warns(DataWarning, match="lower the order"):
        fit = transfer_function(measured(lag, omega=np.geomspace(0.8, 15, 20)), order)
    assert fit.J < 1e-6


@pytest.mark.second
def test_uh60_roll_rate_is_a_low_order_system():
    frf = frequency_response(uh60.sweeps(seed=3), omega=np.geomspace(0.5, 12, 40))
    fit = transfer_function(frf, (1, 2), pair=("p", "lat"), band=(1.0, 10.0))
    assert fit.J < 100
    assert 0 < fit.delay < 0.2


@pytest.mark.second
def test_bad_requests_are_refused():
    frf = frequency_response(uh60.sweeps(seed=3), omega=np.geomspace(0.5, 12, 10))
    with pytest.raises(ValueError, match="name one pair"):
        transfer_function(frf, (1, 2))
    with pytest.raises(ValueError, match="expected degrees"):
        transfer_function(frf, (-1, 2), pair=("p", "lat"))
    for order in ((2,), (0.5, 1)):
        with pytest.raises(ValueError, match="expected degrees"):
            transfer_function(frf, order, pair=("p", "lat"))
    with pytest.raises(ValueError, match="too few for the"):
        transfer_function(measured(second_order, coherence=0.3), (1, 2))


def test_python_control_has_the_same_rational_part():
    fit = transfer_function(measured(lambda s: 3 / (s + 2)), (0, 1), delay=False)
    np.testing.assert_allclose(fit.to_control()(1j * 2.0), fit.response(np.array([2.0]))[0])


@pytest.mark.campaign
@pytest.mark.filterwarnings("ignore::casid.DataWarning")
def test_no_order_fits_worse_than_one_degree_less():
    # A pole on a zero makes them equal; noise gives the solver minima beside the lowest.
    omega = np.geomspace(0.3, 20, 40)
    for seed in (11, 13, 14, 18):
        rng = np.random.default_rng(seed)
        frf = measured(lambda s: second_order(s) / (s + 6), omega=omega, noise=0.15, rng=rng)
        costs = [transfer_function(frf, (n, n + 1)).J for n in range(1, 6)]
        assert (np.diff(costs) <= 1e-9).all()
