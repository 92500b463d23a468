import numpy as np
import pytest
from truths.systems import stepped_input

from casid import Record, StateSpace
from casid.records import standard_deviations
from casid.subspace.fast_pole_errors import bounded, held_interval
from casid.subspace.fourier import Spectrum, spectra
from casid.subspace.modal import Modal
from casid.subspace.refinement import refine

H = 0.04
SLOW = StateSpace([[-0.8, 2.0], [-2.0, -0.8]], [[1.0], [0.5]], np.eye(2), np.zeros((2, 1)))
NONE = np.zeros((2, 1), dtype=bool)


def modal(*lam):
    """Modes of one input and two outputs."""
    n = len(lam)
    B, C = np.arange(1.0, n + 1)[:, None] + 0j, np.arange(1.0, 2 * n + 1).reshape(2, n) + 0j
    return Modal(np.array(lam, dtype=complex), B, C, np.zeros((2, 1)))


def errors(size, seed=0):
    """Errors (parameters, 3) of two real modes of which the second pole's are as large as asked."""
    rows = np.random.default_rng(seed).standard_normal((8, 3))
    rows[1] *= size / np.linalg.norm(rows[1])
    return rows


def gains(rows, m):
    """Errors of the static gains' b/λ, by hand."""
    lam, b = m.lam.real[:, None], m.B.real
    return rows[2:4] / lam - b * rows[:2] / lam**2


@pytest.mark.parametrize("size", [10.0, 1e4, 1e9])
def test_a_time_constant_moves_no_farther_than_its_samples_allow_and_the_gains_as_before(size):
    m, rows = modal(-1.0, -400.0), errors(size)
    found = bounded(rows, np.linalg.norm(rows, axis=1), m, H)
    np.testing.assert_allclose(gains(found, m), gains(rows, m), rtol=1e-6)
    np.testing.assert_array_equal(found[[0, 2, *range(4, 8)]], rows[[0, 2, *range(4, 8)]])
    # E = exp(-16) and its error, or 2 %, which nobody would see of a mode that hardly shows.
    tau, E = 1 / 400, np.exp(-400 * H)
    most = -H / np.log(min(max(E + H * E * size, np.exp(-4)), np.exp(-1)))
    told = np.linalg.norm(found[1]) / 400**2
    assert told == pytest.approx(min(most - tau, size / 400**2), rel=1e-9)


@pytest.mark.parametrize(
    ("lam", "size"),
    [
        ((-1.0, -49.0), 1e6),  # E of 0.14: to first order no more than it allows
        ((-1.0, -70.0), 1.0),  # known within 1.5 %
        ((-1.0, 300.0), 1e6),  # growing
    ],
)
def test_errors_of_other_poles_stay_as_they_are(lam, size):
    rows = errors(size)
    np.testing.assert_allclose(
        bounded(rows, np.linalg.norm(rows, axis=1), modal(*lam), H), rows, rtol=0.02
    )


def test_steps_alone_hide_what_is_fast():
    def lines(h, hold):
        return Spectrum(np.ones(1), np.ones((1, 1)), np.ones((1, 2)), h, hold)

    assert held_interval([lines(0.1, "zoh"), lines(0.04, "zoh")]) == 0.04
    assert held_interval([lines(0.1, "zoh"), lines(0.04, "foh")]) is None
    assert held_interval([lines(0.1, "zoh"), lines(None, "zoh")]) is None
    assert held_interval([]) is None


@pytest.mark.second
def test_a_state_too_fast_for_samples_has_the_errors_of_a_gain(monkeypatch):
    # One state too many, at -400 rad/s: of steps it is a gain of the last sample, whose errors a
    # response has as it has those of a direct term, and no others.
    rng, t = np.random.default_rng(3), H * np.arange(400)
    u = stepped_input(400, 1, rng)
    y = SLOW.simulate(t, u, hold="zoh")
    y += 0.05 * np.std(y, axis=0) * rng.standard_normal(y.shape)
    record = Record(t, u, y, ("u",), ("a", "b"), hold="zoh")
    su, sy = standard_deviations([record])
    data, omega = spectra([record], su, sy, 16.0), np.geomspace(0.5, 12.0, 15)
    A, B = np.pad(SLOW.A, (0, 1)), np.vstack([SLOW.B, [[400.0]]])
    A[2, 2] = -400.0
    fast = StateSpace(A, B, np.hstack([SLOW.C, [[0.005], [-0.005]]]), SLOW.D)

    def told(start, direct):
        system, uncertainty = refine(start, data, su, sy, NONE | direct)
        assert system.poles().real.min() < -200 or start is SLOW
        return np.linalg.norm(uncertainty.response_factor(omega), axis=-1)

    direct, found = told(SLOW, True), told(fast, False)
    assert np.max(found / direct) < 2
    monkeypatch.setattr("casid.subspace.refinement.held_interval", lambda _: None)
    assert np.max(told(fast, False) / direct) > 100  # to first order
