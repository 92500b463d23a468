"""The frequencies at which a response is estimated when nobody names any."""

import numpy as np
import pytest

from casid import Record, frequency_response

DT = 0.02


def sweep(low, high, duration):
    """A logarithmic sweep from low to high [rad/s] through an integrator with a lag."""
    t = np.arange(0, duration, DT)
    rate = low * (high / low) ** (t / duration)
    u = np.sin(np.cumsum(rate) * DT) * np.minimum(1, np.minimum(t, duration - t) / 3)
    y = np.zeros_like(u)
    for k in range(len(t) - 1):  # dy/dt = u - y
        y[k + 1] = y[k] + DT * (u[k] - y[k])
    return Record(t, u[:, None], y[:, None], inputs=("lat",), outputs=("p",), name="sweep")


@pytest.mark.parametrize("count", [1, 3])
def test_the_grid_goes_from_what_the_windows_hold_to_what_the_sweep_excites(count):
    record = sweep(0.3, 10.0, 80.0)
    omega = frequency_response([record] * count).omega
    longest = min(record.duration / 2, count * record.duration / 5)
    assert omega[0] == pytest.approx(2 * 2 * np.pi / longest)  # two periods
    # The sweep is at 8.8 rad/s when it begins to fade out and at 10 when it has; the window over
    # the whole record, which finds its spectrum, fades it out earlier.
    assert 0.9 * 8.8 < omega[-1] < 10.0
    assert len(omega) == 40
