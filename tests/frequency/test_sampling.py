"""Grids, windows and irregular records made fit for spectra, or refused."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
import scipy.signal
from truths import uh60
from truths.systems import DT, LAG, white

from casid import DataWarning, Record, frequency_response
from casid.frequency.sampling import default_windows, equidistant, excited_ends


def test_window_lengths_follow_the_rules():
    records = uh60.sweeps()
    windows = default_windows(records, np.geomspace(0.5, 12, 40))
    assert windows[0] == pytest.approx(20 * 2 * np.pi / 12)
    assert windows[-1] == pytest.approx(35.0)  # half a sweep; a fifth of all is 56 s
    assert len(windows) == 5
    assert default_windows(records[:1], np.array([12.0]))[-1] == pytest.approx(14.0)


def test_jittered_sampling_is_interpolated():
    rng = np.random.default_rng(15)
    even = DT * np.arange(8001)
    odd = even.copy()
    odd[10:-10:7] += 0.4 * DT * rng.uniform(-1, 1, len(odd[10:-10:7]))  # the median stays DT
    knots = np.arange(0.0, 400.5, 0.5)
    smooth = scipy.interpolate.make_interp_spline(knots, rng.standard_normal(len(knots)), k=5)
    found = []
    for t in (even, odd):
        u = smooth(t)[:, None]
        record = Record(t, u, LAG.simulate(t, u), ("u",), ("y",))
        found.append(frequency_response([record], omega=np.array([0.5, 1.0, 2.0]), windows=[40.0]))
    # Inputs between samples are straight lines: (dt/0.5)²/12 of a knot's curvature, 1e-3.
    np.testing.assert_allclose(found[1].G, found[0].G, rtol=2e-3)


def test_between_uneven_samples_channels_are_the_cubic_spline_through_them():
    rng = np.random.default_rng(21)
    t = DT * np.arange(60.0)
    t[1:-1:5] += 0.2 * DT
    y = rng.standard_normal((60, 2))
    y[30, 1] = np.nan
    u = rng.standard_normal((60, 1))
    found = equidistant(Record(t, u, y, ("u",), ("y", "z")), 1.0)
    np.testing.assert_allclose(found.t, DT * np.arange(60))
    spline = scipy.interpolate.CubicSpline
    np.testing.assert_allclose(found.u, spline(t, u)(found.t), atol=1e-12)
    np.testing.assert_allclose(found.y[:, 0], spline(t, y[:, 0])(found.t), atol=1e-12)
    known = np.arange(60) != 30  # no values are added: none where the nearest sample is unknown
    expected = spline(t[known], y[known, 1])(found.t)
    expected[np.abs(found.t[:, None] - t).argmin(axis=1) == 30] = np.nan
    np.testing.assert_allclose(found.y[:, 1], expected, atol=1e-12)


SPOILT = {"a row lost": 0.0, "uneven stamps": 0.2}


@pytest.mark.parametrize("spoilt", SPOILT)
@pytest.mark.parametrize("step", [2, 3, 4, 8])
def test_a_slow_channel_keeps_its_own_samples_and_lacks_those_it_lost(step, spoilt):
    rng = np.random.default_rng(3)
    t = DT * np.arange(400.0)
    t[1:-1] += SPOILT[spoilt] * DT * rng.uniform(-1, 1, 398)
    rows = np.arange(400)
    own = rows % step == 0
    own[(rows > 100) & (rows < 100 + 5 * step)] = False  # lost
    y = np.column_stack([np.cos(t), np.where(own, np.sin(t), np.nan)])
    record = Record(t, rng.standard_normal((400, 1)), y, ("u",), ("fast", "slow"))
    record = record.take(rows != 205)  # in no multiple: no sample of the slow one
    found, dt = equidistant(record, 1.0), record.dt
    fast, slow = found.y.T
    np.testing.assert_allclose(fast, np.cos(found.t), atol=1e-5)
    taken = t[own & (rows != 205)]
    nearest = np.unique(np.round(taken / dt).astype(int))
    nearest = nearest[nearest < found.N]
    # One that lies beyond its sample, in the hole or after the last one, would be made up.
    ends = taken[np.append(np.diff(taken) > 3 * step * DT, True)] + 1e-9
    begins = taken[np.append(False, np.diff(taken) > 3 * step * DT)] - 1e-9
    beyond = (found.t > ends[0]) & (found.t < begins[0]) | (found.t > ends[1])
    at = np.flatnonzero(np.isfinite(slow))
    np.testing.assert_array_equal(at, nearest[~beyond[nearest]])
    away = np.abs(at - 100) > 6 * step  # a spline's error grows beside a hole
    np.testing.assert_allclose(slow[at[away]], np.sin(found.t[at[away]]), atol=1e-4)


@pytest.mark.second
@pytest.mark.parametrize("spoilt", SPOILT)
def test_the_response_of_a_slow_channel_is_the_systems_whatever_the_stamps(spoilt):
    rng = np.random.default_rng(23)
    t = DT * np.arange(8001)
    t[1:-1] += SPOILT[spoilt] * DT * rng.uniform(-1, 1, 7999)
    knots = np.arange(0.0, 400.5, 0.5)
    u = scipy.interpolate.make_interp_spline(knots, rng.standard_normal(len(knots)), k=5)(t)
    y = LAG.simulate(t, u[:, None]) + 1e-3 * rng.standard_normal((8001, 1))
    y[np.arange(8001) % 4 > 0] = np.nan
    record = Record(t, u[:, None], y, ("u",), ("y",)).take(np.arange(8001) != 4001)
    with pytest.warns(DataWarning, match="up to 75 % of an output's samples are missing"):
        found = frequency_response([record], omega=np.array([0.5, 1.0, 2.0]), windows=[40.0])
    # Corners of the inputs' lines as above; the noise of a quarter of the samples, 3e-4.
    np.testing.assert_allclose(found.G, LAG.response(found.omega), rtol=2e-3)


def test_an_interval_too_long_for_the_highest_frequency_is_refused_with_its_place():
    record = white(LAG, np.random.default_rng(16))
    broken = record.take(np.arange(record.N) != 2000)
    with pytest.raises(ValueError, match=r"has a gap of 0\.1 s at t = 99.95 s.*cut\(\)"):
        frequency_response(broken, omega=np.array([1.0, 40.0]))


@pytest.mark.second
def test_a_jittered_record_keeps_its_missing_samples_missing():
    rng = np.random.default_rng(18)
    record = white(LAG, rng, duration=1000.0)
    t = record.t + 0.1 * DT * rng.uniform(-1, 1, record.N)
    y = LAG.simulate(t, record.u)
    y[7000:7100] = np.nan
    with pytest.warns(DataWarning, match="samples are missing"):
        found = frequency_response(
            [Record(t, record.u, y, ("u",), ("y",))], omega=np.array([2.0]), windows=[20.0]
        )
    assert np.isfinite(found.G).all()


@pytest.mark.parametrize(
    ("omega", "message"),
    [
        ([1.0, 70.0], r"omega reaches 70 rad/s.*below Nyquist's 62.8"),
        ([2.0, 1.0], "increasing frequencies above 0"),
        ([0.0, 1.0], "increasing frequencies above 0"),
        ([0.001], "does not hold one period"),
    ],
)
def test_a_grid_that_cannot_be_had_is_refused(omega, message):
    with pytest.raises(ValueError, match=message):
        frequency_response([white(LAG, np.random.default_rng(19))], omega=np.array(omega))


@pytest.mark.second
def test_a_grid_finer_than_the_record_is_warned_of():
    record = white(LAG, np.random.default_rng(20), duration=100.0)
    with pytest.warns(DataWarning, match="finer than a record of 100 s allows"):
        frequency_response([record], omega=np.linspace(1, 2, 50), windows=[20.0])


@pytest.mark.parametrize("windows", [[], [0.0], [500.0]])
def test_window_lengths_must_fit(windows):
    with pytest.raises(ValueError, match="expected lengths between 0 and 400"):
        frequency_response(
            [white(LAG, np.random.default_rng(22))], omega=np.array([1.0]), windows=windows
        )


def sweep(low, high, duration):
    """A logarithmic sweep from low to high [rad/s] through an integrator with a lag."""
    t = np.arange(0, duration, 0.02)
    rate = low * (high / low) ** (t / duration)
    u = np.sin(np.cumsum(rate) * 0.02) * np.minimum(1, np.minimum(t, duration - t) / 3)
    y = np.zeros_like(u)
    for k in range(len(t) - 1):  # dy/dt = u - y
        y[k + 1] = y[k] + 0.02 * (u[k] - y[k])
    return Record(t, u[:, None], y[:, None], inputs=("lat",), outputs=("p",), name="sweep")


@pytest.mark.second
@pytest.mark.parametrize("count", [1, 3])
def test_the_grid_goes_from_what_the_windows_hold_to_what_the_sweep_excites(count):
    record = sweep(0.3, 10.0, 80.0)
    flown = [replace(record, u=k * record.u, y=k * record.y) for k in range(1, count + 1)]
    omega = frequency_response(flown).omega
    longest = min(record.duration / 2, count * record.duration / 5)
    assert omega[0] == pytest.approx(2 * 2 * np.pi / longest)  # two periods
    # The sweep is at 8.8 rad/s when it begins to fade out and at 10 when it has; the window over
    # the whole record, which finds its spectrum, fades it out earlier.
    assert 0.9 * 8.8 < omega[-1] < 10.0
    assert len(omega) == 40


def test_an_output_without_samples_leaves_the_others_interpolated():
    t = 0.05 * np.arange(60) + 0.01 * (np.arange(60) % 2)
    y = np.column_stack([np.full(60, np.nan), np.sin(t), np.cos(t)])
    y[30, 2] = np.nan
    found = equidistant(Record(t, np.sin(t)[:, None], y, ("u",), ("a", "b", "c")), 2.0)
    assert found.equidistant
    assert np.isnan(found.y[:, 0]).all()
    # A cubic spline: error of (dt)⁴/384 of a unit's fourth derivative, 3e-8, more at the ends.
    np.testing.assert_allclose(found.y[:, 1], np.sin(found.t), atol=1e-5)
    lost = np.isnan(found.y[:, 2])
    assert lost.any()
    assert np.abs(found.t[lost] - t[30]).max() < 0.1
    np.testing.assert_allclose(found.y[~lost, 2], np.cos(found.t[~lost]), atol=1e-5)


def stabilised(low, high, noise, gain=3.0, dt=0.02):
    """A sweep on an unstable pole 0.5 behind a lag, held by sampled feedback of noisy outputs."""
    command = sweep(low, high, 80.0).u[:, 0]
    A, B, _ = scipy.signal.cont2discrete(
        (
            np.array([[0.5, 1.0], [0.0, -4.0]]),
            np.array([[0.0], [4.0]]),
            np.eye(2),
            np.zeros((2, 1)),
        ),
        dt,
    )[:3]
    v = noise * np.random.default_rng(5).standard_normal(len(command))
    x, u, y = np.zeros(2), np.zeros(len(command)), np.zeros(len(command))
    for k in range(len(command)):
        y[k] = x[0] + v[k]
        u[k] = command[k] - gain * y[k]
        x = A @ x + B[:, 0] * u[k]
    t = dt * np.arange(len(command))
    return Record(t, u[:, None], y[:, None], ("lat",), ("p",), "flight", hold="zoh")


@pytest.mark.second
def test_the_grid_ends_where_noise_that_is_fed_back_begins():
    found = frequency_response(stabilised(0.3, 10.0, noise=0.02))
    s = 1j * found.omega
    error = np.abs(found.G[:, 0, 0] * (s - 0.5) * (s + 4) / 4 - 1) / found.error[:, 0, 0]
    assert 6.0 < found.omega[-1] < 10.0
    assert not found.flags
    assert np.median(error) < 1.5
    assert error.max() < 5


def test_points_where_noise_is_fed_back_cannot_be_had():
    omega = np.geomspace(1.0, 80.0, 20)
    with pytest.warns(
        DataWarning,
        match=r"rad/s: half or more of the response after 'lat' may be noise .* \(NaN\)",
    ):
        found = frequency_response(stabilised(0.3, 10.0, noise=0.02), omega=omega)
    ((reason, at),) = found.flags.items()
    lost = np.flatnonzero(~np.isfinite(found.G[:, 0, 0]))
    assert "after 'lat' may be noise that is fed back" in reason
    assert at == tuple(lost)
    assert 6.0 < omega[lost[0]] < 12.0
    assert lost[-1] == len(omega) - 1


def test_without_noise_or_feedback_no_input_ends():
    rng = np.random.default_rng(6)
    free = sweep(0.3, 10.0, 80.0)
    noisy = replace(free, y=free.y + 0.02 * rng.standard_normal(free.y.shape))
    u = rng.standard_normal((4000, 1))  # a direct term looks like feedback, at all frequencies
    direct = Record(
        DT * np.arange(4000), u, u + 0.01 * rng.standard_normal(u.shape), ("lat",), ("ay",)
    )
    for record in (stabilised(0.3, 10.0, noise=0.0), noisy, direct):
        assert excited_ends([record]) == {}
