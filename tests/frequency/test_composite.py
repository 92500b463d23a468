"""The composite of several window lengths against a general minimiser."""

import numpy as np
import pytest
import scipy.optimize
from truths.systems import DT, TWO, white

from casid import Record, frequency_response
from casid.frequency.composite import _blend, composite
from casid.frequency.spectra import Conditioned, condition, record_spectra


def pairs(values):
    """Spectra of one pair at one frequency, by window."""
    ones = {"multiple_coherence": np.ones((1, 1)), "condition": np.ones(1)}
    return [
        Conditioned(**{name: np.full((1, 1, 1), v) for name, v in each.items()}, **ones)
        for each in values
    ]


def residuals(parts):
    """Those of the composite's cost, of log Gxx, log Gyy and Gxy."""
    error = np.array([part.random_error.item() for part in parts])
    Gxx, Gyy, Gxy = (np.array([getattr(p, n).item() for p in parts]) for n in ("Gxx", "Gyy", "Gxy"))
    # Those that hardly hold any of the input do not count.
    sw = np.where(Gxx < Gxx[error.argmin()] / 4, 0.0, (error / error.min()) ** -2)
    own = np.abs(Gxy) ** 2 / (Gxx * Gyy)

    def found(q):
        x, y, z = np.exp(q[0]), np.exp(q[1]), q[2] + 1j * q[3]
        off = (z - Gxy) / np.abs(Gxy)
        gamma = np.abs(z) ** 2 / (x * y) / own - 1
        rows = x / Gxx - 1, y / Gyy - 1, off.real, off.imag, np.sqrt(5) * gamma
        return np.concatenate([sw * row for row in rows])

    return found


@pytest.mark.second
@pytest.mark.parametrize("decades", [0.1, 1.0, 3.0])
def test_the_composite_minimises_its_cost(decades):
    """Windows whose inputs' power differs by so much; SciPy from every one of them."""
    rng = np.random.default_rng(13)
    for _ in range(10):
        values = []
        for _ in range(4):
            Gxx = 10 ** (decades * (rng.random() - 0.5))
            Gxy = (
                Gxx * (2 - 1j) * (1 + 0.05 * rng.standard_normal() + 0.05j * rng.standard_normal())
            )
            Gyy = abs(Gxy) ** 2 / Gxx / (0.5 + 0.48 * rng.random())
            error = 0.1 + 0.05 * rng.random()
            values.append({"Gxx": Gxx, "Gxy": Gxy, "Gyy": Gyy, "random_error": error})
        parts = pairs(values)
        cost = residuals(parts)
        starts = [
            (np.log(v["Gxx"]), np.log(v["Gyy"]), v["Gxy"].real, v["Gxy"].imag) for v in values
        ]
        ends = [scipy.optimize.least_squares(cost, q, x_scale="jac", xtol=1e-12) for q in starts]
        best = min(ends, key=lambda end: end.cost)
        merged = composite(parts, np.ones((4, 1), dtype=bool))
        Gxx, Gyy, Gxy = (getattr(merged, name).item() for name in ("Gxx", "Gyy", "Gxy"))
        found = np.array([np.log(Gxx), np.log(Gyy), Gxy.real, Gxy.imag])
        assert np.sum(cost(found) ** 2) / 2 <= best.cost * (1 + 1e-9)
        np.testing.assert_allclose(found, best.x, atol=1e-5 * np.abs(best.x).max())


@pytest.mark.second
def test_nothing_beside_the_composite_of_windows_that_contradict_each_other_costs_less():
    # Power over four decades, responses half of themselves apart, coherence down to 0.05.
    rng = np.random.default_rng(7)
    for _ in range(60):
        Gxx = 10 ** rng.uniform(-2, 2, 5)
        Gxy = Gxx * (2 - 1j) * (1 + 0.5 * rng.standard_normal((5, 2)) @ [1, 1j])
        Gyy = np.abs(Gxy) ** 2 / Gxx / rng.uniform(0.05, 0.999, 5)
        error = 0.1 / rng.uniform(0.05, 1.0, 5) ** 0.25
        rows = zip(Gxx, Gxy, Gyy, error, strict=True)
        parts = pairs(
            [dict(zip(("Gxx", "Gxy", "Gyy", "random_error"), r, strict=True)) for r in rows]
        )
        merged, cost = composite(parts, np.ones((5, 1), dtype=bool)), residuals(parts)
        x, y, z = (getattr(merged, name).item() for name in ("Gxx", "Gyy", "Gxy"))
        found = np.array([np.log(x), np.log(y), z.real, z.imag])
        near = scipy.optimize.least_squares(cost, found, x_scale="jac", xtol=1e-12)
        assert near.cost == pytest.approx(np.sum(cost(found) ** 2) / 2, rel=1e-4)


def test_the_composite_of_one_window_is_that_window():
    record = white(TWO, np.random.default_rng(14), noise=0.3)
    part = condition(record_spectra([record], np.array([2.0, 5.0]), 20.0), conditioned=True)
    merged = composite([part], np.ones((1, 2), dtype=bool))
    for name in ("Gxx", "Gxy", "Gyy", "random_error", "multiple_coherence"):
        np.testing.assert_allclose(getattr(merged, name), getattr(part, name), rtol=1e-9)


def test_correlations_of_windows_are_blended_where_known_and_none_elsewhere():
    # Two lengths of two outputs at three frequencies: both used; one lost; neither used.
    one, other = (
        np.tile(np.array([[1.0, r], [r, 1.0]], dtype=complex), (3, 1, 1)) for r in (0.2, 0.6)
    )
    other[1] = np.nan
    W = np.zeros((2, 3, 2, 1))
    W[:, :2] = np.array([0.25, 0.75])[:, None, None, None]
    found = _blend(W, [one, other])
    np.testing.assert_allclose(found[0], [[1.0, 0.5], [0.5, 1.0]], rtol=1e-12)
    np.testing.assert_array_equal(found[1:], np.tile(np.eye(2), (2, 1, 1)))
    assert _blend(W, [one, None]) is None


@pytest.mark.parametrize("ratio", [1.0, 30.0, 1000.0])
def test_windows_of_unequal_power_that_say_the_same_are_not_contradicted(ratio):
    # Two lengths see other records: inputs of other power, one response and coherence.
    gains = {"Gxy": 2 - 1j, "Gyy": 5 / 0.98, "Gxx": 1.0}
    values = [{n: g * power for n, g in gains.items()} for power in (1.0, ratio)]
    parts = pairs([each | {"random_error": 0.1} for each in values])
    merged = composite(parts, np.ones((2, 1), dtype=bool))
    assert merged.response.item() == pytest.approx(2 - 1j, rel=1e-6)
    assert merged.coherence.item() == pytest.approx(0.98, rel=1e-6)


@pytest.mark.parametrize(("power", "counts"), [(0.24, False), (0.26, True), (100.0, True)])
def test_windows_that_hardly_hold_the_input_do_not_count(power, counts):
    best = {"Gxx": 1.0, "Gxy": 2 - 1j, "Gyy": 5 / 0.9, "random_error": 0.1}
    # As accurate by its own word, and half off.
    off = {"Gxx": power, "Gxy": 3 * power, "Gyy": 10 * power, "random_error": 0.1001}
    merged = composite(pairs([off, best]), np.ones((2, 1), dtype=bool))
    assert (abs(merged.response.item() - (2 - 1j)) > 1e-3) == counts


def both_axes(seed):
    """Sweeps to 14 rad/s, two of each input, that the other follows in part; noise on outputs."""
    rng, t = np.random.default_rng(seed), DT * np.arange(1800)
    part = np.clip((t - 3) / 84, 0, 1)
    # Most of the time is spent at low frequencies.
    turned = 84 * (0.3 * part + 0.0187 * 13.7 * ((np.exp(4 * part) - 1) / 4 - part))
    swept = np.clip((t - 3) / 2, 0, 1) * np.clip((87 - t) / 2, 0, 1) * np.sin(turned)
    for axis, share in ((0, 0.35), (1, 0.35), (0, -0.2), (1, -0.2)):
        moved = 0.1 * np.convolve(rng.standard_normal(len(t)), np.ones(40) / 40, "same")
        u = np.column_stack([swept, share * swept + moved])[:, [axis, 1 - axis]]
        y = TWO.simulate(t, u) + 0.005 * rng.standard_normal((len(t), 2))
        yield Record(t, u, y, TWO.inputs, TWO.outputs, f"{axis} {share}")


@pytest.mark.second
def test_where_a_sweep_ends_the_composite_is_as_good_as_its_stated_error():
    omega = np.array([9.0, 11.0, 13.0, 14.0])
    found = [
        frequency_response([*both_axes(seed)], omega=omega, method="windows") for seed in range(6)
    ]
    off = [np.abs(each.G / TWO.response(omega) - 1) ** 2 / 2 for each in found]
    stated = np.median([each.error for each in found], axis=0)
    assert (np.sqrt(np.mean(off, axis=0)) < 1.2 * stated).all()
    assert (stated < 0.4).all()
