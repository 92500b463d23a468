"""Seams: flights of one record are joined at a sample that is known, and flown ones have none."""

import numpy as np
import pytest

from casid import Record, inspect_records
from casid.seams import seam, seams_told

NAMES, NOISE = ("phi", "theta", "u", "p"), np.array([0.002, 0.002, 0.1, 0.003])
N, STEP = 600, 0.02


def flown(seed, level, n=N):
    """A smooth flight about a level of φ, θ, u and p, each a sum of sines, with noise."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(n)
    size, omega, phase = rng.uniform(0.3, 1, (3, 4, 3)) * [[[1.0]], [[2.0]], [[6.0]]]
    swings = (size * np.sin(omega * t[:, None, None] + phase)).sum(axis=2)
    return level + swings * [0.05, 0.04, 0.5, 0.1] + NOISE * rng.standard_normal((n, 4))


def record(y, t=None):
    t = STEP * np.arange(len(y)) if t is None else t
    return Record(t, np.zeros((len(y), 1)), y, ("lat",), NAMES, "flight")


@pytest.mark.parametrize("seed", range(8))
def test_two_flights_that_were_joined_are_told_and_each_alone_is_not(seed):
    first, second = flown(seed, [0, 0.02, 40, 0]), flown(seed + 50, [0.3, -0.2, 48, 0])
    assert seam(record(first)) is None
    assert seam(record(second)) is None
    k = 100 + 50 * seed
    at, names = seam(record(np.vstack([first[:k], second[k:]])))
    assert at == pytest.approx(k * STEP, abs=1.5 * STEP)
    assert {"u"} <= {*names} <= {"phi", "theta", "u"}  # a rate is free to leap


@pytest.mark.second
def test_a_seam_is_told_by_an_inspection_with_what_to_do():
    first, second = flown(1, [0, 0.02, 40, 0]), flown(2, [0.3, -0.2, 48, 0])
    joined = record(np.vstack([first[:300], second[300:]]))
    (said,) = seams_told(joined)
    assert "phi, theta, u leap at 6 s, all at once" in said
    assert f"flight: {said}" in inspect_records([joined]).advice


def test_what_leaps_in_a_gap_or_alone_or_comes_back_is_no_seam():
    y = flown(3, [0, 0.02, 40, 0])
    late = STEP * np.arange(N) + 2.0 * (np.arange(N) >= 300)
    moved, alone, glitch = y.copy(), y.copy(), y.copy()
    moved[300:, :3] += [0.5, 0.5, 10]
    alone[300:, 2] += 10  # a sensor was set anew
    glitch[300:302, :3] += [0.5, 0.5, 10]
    assert seam(record(moved)) is not None
    assert seam(record(moved, late)) is None
    assert seam(record(alone)) is None
    assert seam(record(glitch)) is None


def test_rates_that_begin_at_once_without_noise_are_no_seam():
    t = STEP * np.arange(N)
    swing = np.sin(t - 2) * (t > 2)  # the model of an exercise, at rest before
    y = np.column_stack([0.2 * swing, 0.8 + 0.2 * swing, 20 + swing, 0 * t])
    assert seam(record(y)) is None
    y[150:, :3] += [0.02, 0.02, 0.1]  # a few times as much as it moves in a sample
    assert seam(record(y)) is not None


def test_an_estimator_that_is_set_anew_at_rest_is_told():
    anew = np.zeros((N, 4))
    anew[300:] = [0.3, 0.2, 8.0, 0.0]
    assert seam(record(anew)) == (pytest.approx(300 * STEP), ("phi", "theta", "u"))


def test_rest_and_short_records_have_none():
    assert seam(record(np.zeros((N, 4)))) is None
    assert seam(record(flown(4, [0, 0, 40, 0], 20))) is None
    lost = flown(5, [0, 0, 40, 0])
    lost[::2] = np.nan
    assert seam(record(lost)) is None
