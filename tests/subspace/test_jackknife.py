"""Records of two axes, two on each, by SciPy's sampling alone: what is wrong in one of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from casid import Record, pbsid
from casid.subspace.fourier import Spectrum
from casid.subspace.jackknife import ROUGHLY, Jackknife, _gains, _regressed
from casid.subspace.modal import Modal

DT = 0.04
ROLL = np.array([[-3.0, 0, 0, 0], [1, 0, 0, 0], [0.4, 0, -1.2, 2.0], [0, 0, -2.0, -1.2]])
HOVER = np.array([[-1.0, -2, 0, 0], [1, 0, 0, 0], [0, 0.5, -4.0, 0], [0, 0, 1, -0.3]])
STICKS = np.array([[8.0, 0.5], [0, 0], [0.5, 4.0], [0, 3.0]])
NOISE = 0.003 * np.ones(4)


def flown(A, axis, seed, *, gust=0.0):
    """A record of steps on one stick, rates fed back to both, in air that pushes the rates."""
    rng, N = np.random.default_rng([seed, axis]), 400
    G = np.hstack([STICKS, [[1.0, 0], [0, 0], [0, 1], [0, 0]]])
    plant = A, G, np.eye(4), np.zeros((4, 4))
    Ad, Bd = scipy.signal.cont2discrete(plant, DT, "zoh")[:2]
    wanted = np.zeros((N, 2))
    wanted[:, axis] = 0.1 * np.repeat(rng.choice([-1, 0, 1], N // 10), 10)
    x, air, u, y = np.zeros(4), np.zeros(2), np.zeros((N, 2)), np.zeros((N, 4))
    for k in range(N):
        y[k] = x + NOISE * rng.standard_normal(4)
        u[k] = wanted[k] - 0.02 * y[k, [0, 2]]
        x = Ad @ x + Bd @ np.concatenate([u[k], air])
        air = 0.95 * air + gust * np.sqrt(1 - 0.95**2) * rng.standard_normal(2)
    names = ("lat", "ped"), ("p", "phi", "r", "v")
    return Record(DT * np.arange(N), u, y, *names, f"{names[0][axis]} {seed}", hold="zoh")


def campaign(A, seed, gust=0.0):
    """Two records on each axis, the first of them in gusts."""
    return [flown(A, k % 2, 10 * seed + k // 2, gust=gust * (not k)) for k in range(4)]


def scaled(record, name, factor):
    u = record.u * np.where(np.array(record.inputs) == name, factor, 1.0)
    y = record.y * np.where(np.array(record.outputs) == name, factor, 1.0)
    return replace(record, u=u, y=y)


def remarks(records):
    return pbsid(records, order=4, past=8, pole=6.0, feedthrough=False).remarks


@pytest.mark.parametrize(("A", "seed"), [(ROLL, 1), (HOVER, 2)])
@pytest.mark.parametrize("gust", [0.0, 0.3])
def test_gusts_in_one_record_make_none_disagree(A, seed, gust):
    assert not [each for each in remarks(campaign(A, seed, gust)) if "disagree" in each]


@pytest.mark.second
@pytest.mark.parametrize(("A", "k"), [(ROLL, 0), (HOVER, 2)])
@pytest.mark.parametrize(("name", "factor"), [("lat", 100.0), ("lat", -1.0), ("p", -1.0)])
@pytest.mark.filterwarnings("ignore:inputs follow")
def test_another_unit_or_sign_in_one_of_two_records_names_it(A, k, name, factor):
    records = campaign(A, 3)
    records[k] = scaled(records[k], name, factor)
    (said,) = (each for each in remarks(records) if "disagree" in each)
    assert records[k].name in said
    if said.startswith("Records"):
        assert records[2 - k].name in said
        assert "which of the two is wrong" in said


def test_a_multiple_is_told_and_what_follows_something_else_is_not():
    rng, band = np.random.default_rng(0), np.repeat(np.arange(4), 5)
    x, other = (rng.standard_normal((20, 1)) * (1 + 1j) for _ in range(2))
    a, error, power = _regressed(-2 * x, x, band)
    np.testing.assert_allclose((a, error, power), (-2, 0, 4 * np.sum(np.abs(x) ** 2)), atol=1e-12)
    assert _regressed(3 * other, x, band)[2] == 0  # nothing of it follows x
    assert _regressed(1.1 * x, x, band)[2] == 0  # no other gain


@pytest.mark.parametrize(("gain", "told"), [(2.1, True), (1.9, False), (0.48, True), (0.52, False)])
def test_a_gain_twice_or_half_as_large_is_another(gain, told):
    x, band = np.ones((20, 1)), np.repeat(np.arange(4), 5)
    assert (_regressed(gain * x, x, band)[2] > 0) == told


@pytest.mark.parametrize(("off", "told"), [(0.49, True), (0.51, False)])
def test_a_gain_explains_four_fifths_of_the_power(off, told):
    x, band = np.ones((20, 1)), np.repeat(np.arange(4), 5)
    assert (_regressed(3 * (1 + 1j * off) * x, x, band)[2] > 0) == told  # 1 / (1 + off²) of it


@pytest.mark.parametrize(("errors", "told"), [(2.55, True), (2.45, False)])
def test_a_clear_gain_is_two_and_a_half_errors_of_one_band_left_out(errors, told):
    x, band = np.ones((2, 1)), np.arange(2)
    apart = 3 / errors / np.sqrt(2)  # left with either band alone, the gain is off by this
    y = np.array([[3 + apart], [3 - apart]])
    a, error, power = _regressed(y, x, band)
    alone = [np.linalg.lstsq(x[band != b], y[band != b])[0].item() for b in band]
    np.testing.assert_allclose((a, error), (3, np.linalg.norm(np.subtract(alone, 3))))
    assert (power > 0) == told


def other(factors, part=1.0):
    """Gains found in a record whose outputs p, r are such multiples (K, 2) of what moves them."""
    rng, K = np.random.default_rng(1), len(factors)
    modal = Modal(-np.ones(1) + 0j, np.zeros((1, 1)), np.ones((2, 1)) + 0j, np.ones((2, 1)))
    omega = np.exp(np.log(0.1) + 0.3 / 40 * (np.arange(K) + 0.5))  # 40 in 0.3 nepers
    U = np.exp(2j * np.pi * rng.random((K, 1)))
    noise = rng.normal(0, 0.01, (K, 2)) + 1j * rng.normal(0, 0.01, (K, 2))
    own, rest = (Spectrum(omega, U, Y, None, "foh") for Y in (factors * U, U + noise))
    record = SimpleNamespace(inputs=("lat",), outputs=("p", "r"))
    campaign = SimpleNamespace(records=[record, record])
    jackknife = SimpleNamespace(data=[[own], [rest]], rest=lambda _: [rest], campaign=campaign)
    return {gain.channel: gain for gain in _gains(jackknife, 0, modal, part)}


@pytest.mark.parametrize(("gain", "told"), [(1.8, True), (1.45, False)])
def test_a_model_that_is_not_refined_asks_for_one_at_smaller_gains(gain, told):
    factors = np.tile([gain, 1.0], (400, 1))
    assert ("p" in other(factors, ROUGHLY)) == told
    assert not other(factors)


@pytest.mark.parametrize(
    ("factor", "told"), [(3.3, True), (3.5, False), (0.6, True), (0.57, False)]
)
def test_a_sign_is_told_where_half_of_the_other_channels_power_is_explained(factor, told):
    found = other(np.tile([-1.0, factor], (400, 1)))  # leaves (1 - 1 / factor)² of r's power
    assert list(found) == ["p"] * told


@pytest.mark.parametrize(("lines", "spread"), [(20, 0.0), (40, 0.3)])
def test_the_error_of_a_gain_is_its_scatter_between_bands_of_three_tenths_of_a_neper(lines, spread):
    up_and_down = np.resize(np.repeat([1.0, -1.0], lines), 400)
    (gain,) = other(np.stack([-1 + 0.3 * up_and_down, np.ones(400)], axis=1)).values()
    # ten bands of one power, so that one left out moves the mean by a ninth of its distance
    np.testing.assert_allclose(gain.error, spread * np.sqrt(10) / 9, rtol=0.04, atol=0.006)
    np.testing.assert_allclose(gain.gain, -1, atol=0.02)


@pytest.mark.parametrize(("channel", "rival"), [("lat", 2), ("ped", 3), ("p", 2)])
def test_the_rival_moves_the_same_input_on_its_own_and_not_by_feedback(channel, rival):
    names = ("lat", "ped"), ("p",)
    # a record judged, one in which feedback moves everything, one on each stick
    sizes = np.array([[1.0, 0.1], [1.0, 1.0], [0.9, 0.05], [0.05, 0.9]])
    signs = np.array([[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    records = [Record(np.arange(4.0), size * signs, np.zeros((4, 1)), *names) for size in sizes]
    none = SimpleNamespace(
        campaign=SimpleNamespace(records=records), rest=lambda *_: [], _settled=lambda _: None
    )
    assert Jackknife.rival(none, 0, channel) == rival
