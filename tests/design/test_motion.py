"""Motion of a nonlinear structure from sample to sample."""

import numpy as np

from casid import NonlinearModel, parameter
from casid.design.motion import Motion


class Integrator(NonlinearModel):
    states, inputs, outputs = ("x",), ("m",), ("x",)
    b: float = parameter(default=1.0, lower=0.1, upper=9.0, unit="1/s")
    drift: float = parameter(default=0.0, lower=-1.0, upper=1.0, unit="1/s")

    def derivatives(self, x, u):
        return [self.b * u.m**2 + self.drift + 0 * x.x]


def test_aircraft_with_delays_and_trims_of_their_own_fly_by_one_function():
    h = 0.05
    t, K = h * np.arange(81), np.zeros((1, 1))
    made = Motion(Integrator(), K, h=h, N=len(t), parts=4, longest=0.11)
    for tau, b, m in ((0.0, 1.0, 0.0), (0.03, 2.0, 0.5), (0.11, 0.7, -1.0)):
        place = made.place(np.array([3.0, m]), np.array([b, 0.2]), np.array([tau]))
        flown = made.fly(place, 0.1 * t[:, None])
        # about the trim, whose own drift is taken off: ∫ b ((m + 0.1 s)² - m²) ds
        s = np.maximum(t - tau, 0.0)
        x = b * (0.1 * m * s**2 + 0.01 * s**3 / 3)
        np.testing.assert_allclose(flown[:, 2], x, atol=0.01 * h**2)  # of the break at s = 0
        np.testing.assert_allclose(flown[:, 0], 0.1 * t, atol=1e-12)


def test_feedback_is_about_each_ones_own_trim():
    h, K = 0.05, np.array([[0.4]])
    made = Motion(Integrator(), K, h=h, N=81, parts=4, longest=0.0)
    place = made.place(np.array([3.0, 1.0]), np.array([1.0, 0.2]), np.zeros(1))
    flown = made.fly(place, np.zeros((81, 1)))
    np.testing.assert_array_equal(flown, 0.0)
    r = 1e-5 * np.ones((81, 1))
    u, y, _ = made.fly(place, r).T
    np.testing.assert_allclose(u, 1e-5 - 0.4 * y, atol=1e-9)
    t = h * np.arange(81)  # dx/dt = 2 u about m = 1
    np.testing.assert_allclose(y, 1e-5 / 0.4 * (1 - np.exp(-0.8 * t)), atol=2e-8)
