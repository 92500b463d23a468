"""Records of two axes, two on each, by SciPy's sampling alone: what is wrong in one of them."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from casid import Record, pbsid
from casid.subspace.left_out import _regressed

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


@pytest.mark.parametrize(("A", "k"), [(ROLL, 0), (HOVER, 2)])
@pytest.mark.parametrize(("name", "factor"), [("lat", 100.0), ("lat", -1.0), ("p", -1.0)])
@pytest.mark.filterwarnings("ignore:the controller feeds")
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
