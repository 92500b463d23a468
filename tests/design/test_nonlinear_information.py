"""What nonlinear flights tell, against the bound by differences of an own simulation."""

import casadi as ca
import numpy as np
import pytest

from casid import DesignSettings, Limits, NonlinearModel, design_inputs, parameter
from casid.design.nonlinear_information import Flown
from casid.free import free_parameters

A, LP, LPP, K, TAU = range(5)
BELIEVED = np.array([-3.0, -1.2, 0.5, 8.0, 0.06])
SIGMA = np.array([0.01, 0.008])


class Damped(NonlinearModel):
    """A pendulum whose damping grows with its rate, of which no small motion tells."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("p", "phi")
    a: float = parameter(default=BELIEVED[A], lower=-20.0, upper=20.0, unit="1/s^2")
    Lp: float = parameter(default=BELIEVED[LP], lower=-20.0, upper=5.0, unit="1/s")
    Lpp: float = parameter(default=BELIEVED[LPP], lower=-5.0, upper=10.0, unit="1/rad")
    k: float = parameter(default=BELIEVED[K], lower=0.0, upper=60.0, unit="rad/s^2")
    tau: float = parameter(default=BELIEVED[TAU], lower=0.0, upper=0.3, unit="s")

    def derivatives(self, x, u):
        damping = self.Lp * x.p - self.Lpp * x.p * ca.fabs(x.p)
        return [self.a * ca.sin(x.phi) + damping + self.k * u.lat, x.p]

    def delays(self):
        return {"lat": self.tau}


def damped(P, x, t, u, parts=10):
    """p and φ (n, N, 2) of parameters (n, 5) from states (n, 2), by Runge and Kutta's method."""
    h, found = (t[1] - t[0]) / parts, [x]

    def rate(s, x):
        lat = np.interp(s - P[:, TAU], t, u)
        p, phi = x.T
        damping = P[:, LP] * p - P[:, LPP] * p * np.abs(p)
        return np.stack([P[:, A] * np.sin(phi) + damping + P[:, K] * lat, p], axis=1)

    for s in (t[:-1, None] + h * np.arange(parts)).ravel():
        k1 = rate(s, x)
        k2 = rate(s + h / 2, x + h / 2 * k1)
        k3 = rate(s + h / 2, x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(s + h, x + h * k3))
        found.append(x)
    return np.stack(found[::parts], axis=1)


def bound(P, t, u):
    """Cramér-Rao bound of the parameters (5,), initial states and biases estimated too."""
    at = np.append(P, [0.0, 0.0])
    steps = np.diag(np.append(1e-4 * np.abs(P), [1e-5, 1e-5]))
    z = np.vstack([at + steps, at - steps])
    y = damped(z[:, :5], z[:, 5:], t, u)
    moves = (y[:7] - y[7:]) / (2 * np.diag(steps))[:, None, None]
    biases = np.broadcast_to(np.eye(2)[:, None], (2, *y.shape[1:]))
    J = (np.concatenate([moves, biases]) / SIGMA).reshape(9, -1)
    return np.sqrt(np.diag(np.linalg.inv(J @ J.T)))[:5]


@pytest.mark.second
@pytest.mark.parametrize("a", [-3.0, 2.0])
def test_errors_are_those_of_the_nonlinear_flight_with_all_parameters_estimated(a):
    limits = Limits(sticks={"lat": 0.3}, responses={"p": 1.2, "phi": 0.9})
    noise = dict(zip(Damped.outputs, SIGMA, strict=True))
    settings = DesignSettings(dt=0.04, iterations=10, draws=0, method="steps")
    held = {"lat": {"p": 0.2, "phi": 0.5}} if a > 0 else {}
    model, P = Damped(a=a), np.append(a, BELIEVED[1:])
    made = design_inputs(model, limits, 10.0, noise=noise, feedback=held, settings=settings)
    assert made.names == ("a", "Lp", "Lpp", "k", "tau")
    assert (made.untold, made.blind) == ((), ())
    np.testing.assert_allclose(made.std_errors, bound(P, made.t, made.u[:, 0]), rtol=2e-3)
    if not held:
        usual = made.alternatives[0]
        np.testing.assert_allclose(usual.std_errors, bound(P, made.t, usual.r[:, 0]), rtol=2e-3)
        flown = damped(P[None], np.zeros((1, 2)), made.t, made.u[:, 0])[0]
        np.testing.assert_allclose(made.y, flown, atol=2e-3)


def test_an_equation_without_a_derivative_in_the_flight_is_refused():
    class Rooted(Damped):
        def derivatives(self, x, u):
            p, phi = super().derivatives(x, u)
            return [p - ca.sqrt(ca.fabs(x.p)), phi]

    t, none = 0.04 * np.arange(50), np.zeros((50, 2))
    flown = Flown(free_parameters(Rooted()), t, none[:, :1], none, none)
    with pytest.raises(ValueError, match="Rooted has an equation without a derivative some"):
        flown.information(np.eye(2))
