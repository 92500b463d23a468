"""Inputs as functions of few numbers: what they look like, and their slopes."""

import numpy as np
import pytest

from casid.design.shapes import Steps, Waves
from casid.design.signals import wave_family

T = 0.05 * np.arange(201)


def sequence(**change):
    told = {"rest": 1.0, "step": 0.8, "edge": 0.2, "size": 2.0, **change}
    return Steps(T, **told, rng=np.random.default_rng(0))


def waves():
    omega = 2 * np.pi / 9.0 * np.arange(2, 6)
    size = np.sqrt(2 * np.array([0.5, 0.1, 0.2, 0.3]))
    return Waves(wave_family(T, 1.0, omega) * np.tile(size, 2), np.array([0, 1, -2, 0.5]), 2.0)


def test_steps_have_their_levels_between_their_switching_times_and_rest_before_and_after():
    shape = sequence()
    x = shape.start + np.append(np.zeros(shape.n), 0.3 * np.sin(np.arange(shape.n + 1)))
    times, r = shape.times(x), shape.signal(x)
    for level, begin, end in zip(x, times, times[1:], strict=False):
        held = (begin + 0.2 <= T) & (end >= T)
        np.testing.assert_allclose(r[held], 2.0 * level, atol=1e-12)
    assert not np.any(r[times[0] >= T])
    assert not np.any(np.abs(r[times[-1] + 0.2 <= T]) > 1e-12)


def test_edges_are_cubics_and_no_steeper_than_once_and_a_half_a_line():
    shape = sequence()
    begin = shape.times(shape.start)[0]
    fine = Steps(np.linspace(0, 10, 20001), rest=1.0, step=0.8, edge=0.2, size=2.0,
                 rng=np.random.default_rng(0))  # fmt: skip
    r = fine.signal(fine.start)
    level = 2.0 * fine.start[0]
    assert np.interp(begin + 0.05, np.linspace(0, 10, 20001), r) == pytest.approx(level * 5 / 32)
    largest = np.abs(np.diff(2.0 * fine.start[: fine.n], prepend=0, append=0)).max()
    assert np.abs(np.diff(r)).max() / 0.0005 == pytest.approx(1.5 * largest / 0.2, rel=1e-3)


@pytest.mark.parametrize("shape", [sequence(), waves()])
def test_slopes_are_differences(shape):
    rng = np.random.default_rng(1)
    x = shape.start + 0.1 * rng.standard_normal(len(shape.start))
    x = np.clip(x, shape.lower, shape.upper - 1e-3)
    row = rng.standard_normal(len(T))
    moves = 1e-6 * np.eye(len(x))
    differences = [(shape.signal(x + d) - shape.signal(x - d)) @ row / 2e-6 for d in moves]
    np.testing.assert_allclose(shape.pulled_back(x, row), differences, atol=1e-6)


def test_waves_have_their_powers_and_phases():
    r = waves().signal(waves().start)[T >= 1.0][:-1]
    spectrum = np.fft.rfft(r)[2:6] / len(r)
    np.testing.assert_allclose(2 * np.abs(spectrum) ** 2, [0.5, 0.1, 0.2, 0.3], rtol=1e-9)
    np.testing.assert_allclose(np.angle(spectrum), [0.0, 1.0, -2.0, 0.5], atol=1e-9)
