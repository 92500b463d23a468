"""Output error against simulated truth, closed forms and an independent estimator."""

from dataclasses import replace

import numpy as np
import pytest

from casid import Model, Record, Rows, Scalar, SolverOptions, parameter
from casid.errors import ConvergenceError
from casid.shooting.output_error import output_error, simulate

T = 0.02 * np.arange(600)


class Roll(Model):
    """Lateral velocity, roll rate and bank; unstable: 0.10 ± 0.72j and -2.5 1/s."""

    states = ("v", "p", "phi")
    inputs = ("lat", "ped")
    outputs = ("ay", "p", "phi")

    Yv: Scalar = parameter(default=-0.1, lower=-2.0, upper=0.5, unit="1/s")
    Lv: Scalar = parameter(default=-0.15, lower=-1.0, upper=1.0, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-2.2, lower=-20.0, upper=0.0, unit="1/s")
    Ylat: Scalar = parameter(default=2.0, lower=-10.0, upper=10.0, unit="m/s^2")
    Llat: Scalar = parameter(default=10.0, lower=-40.0, upper=40.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=1.5, lower=-10.0, upper=10.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.075, lower=0.0, upper=0.25, unit="s")

    def A(self) -> Rows:
        return [[self.Yv, 0, 9.81], [self.Lv, self.Lp, 0], [0, 1, 0]]

    def B(self) -> Rows:
        return [[self.Ylat, 0], [self.Llat, self.Lped], [0, 0]]

    def C(self) -> Rows:
        return [[self.Yv, 0, 0], [0, 1, 0], [0, 0, 1]]

    def D(self) -> Rows:
        return [[self.Ylat, 0], [0, 0], [0, 0]]

    def delays(self) -> dict[str, Scalar]:
        return {"lat": self.tau}


TRUTH = Roll()
NAMES = TRUTH.parameter_names()


def lag(t, u, T_lag):
    """What a stick shaped by a first-order lag does; steps sampled bare have no derivative."""
    out = np.zeros_like(u)
    for k in range(1, len(t)):
        out[k] = out[k - 1] + (1 - np.exp(-(t[k] - t[k - 1]) / T_lag)) * (u[k] - out[k - 1])
    return out


def excitation(t, seed):
    """Multi-step sticks of 0.1 through a 0.15 s lag, at rest for the first second."""
    rng = np.random.default_rng(seed)
    levels = rng.choice([-0.1, 0.0, 0.1], size=(int(t[-1] / 0.7) + 2, 2))
    steps = levels[np.floor(t / 0.7).astype(int)] * (t[:, None] > 1.0)
    return lag(t, steps, 0.15)


def flown(model=TRUTH, t=T, seed=0, exact=False, x0=(0.3, -0.02, 0.01), bias=(0.1, 0.01, -0.02)):
    """One closed-loop record: bank and rate are fed back to the lateral stick, without noise.

    The loop runs on the exactly delayed stick; the outputs are then those of the intersample model
    or, if ``exact``, of the exactly delayed input.
    """
    blank = np.zeros((len(t), 3))
    r = excitation(t, seed)
    u, y = r, blank
    for _ in range(60):  # the loop, solved by relaxation: contracts as the sweep moves forward
        y = model.system().simulate(t, u, np.array(x0))
        new = r - np.column_stack([lag(t, 0.03 * y[:, 2] + 0.01 * y[:, 1], 0.1), 0 * t])
        if np.abs(new - u).max() < 1e-12:
            break
        u = new
    record = Record(t, u, blank, model.inputs, model.outputs, f"record {seed}")
    if exact:
        y = model.system().simulate(t, u, np.array(x0)) + np.array(bias)
    else:
        y = simulate(model, record, np.array(x0), np.array(bias))
    return replace(record, y=y)


def off(model=TRUTH, share=0.3):
    """A start every parameter of which is off by the share, up and down in turn."""
    signs = np.where(np.arange(len(model.vector())) % 2, 1.0, -1.0)
    return model.with_vector(model.vector() * (1 + share * signs))


def relative_error(fit, model=TRUTH):
    return np.abs(fit.model.vector() / model.vector() - 1)


def test_unstable_plant_in_closed_loop_is_recovered_from_30_percent_off_delay_included():
    assert TRUTH.system().poles()[0].real > 0.05
    fit = output_error(off(), [flown(seed=1), flown(seed=2)])
    assert fit.success
    assert relative_error(fit).max() < 1e-6
    np.testing.assert_allclose(fit.initial_states, [[0.3, -0.02, 0.01]] * 2, atol=1e-6)
    np.testing.assert_allclose(fit.biases, [[0.1, 0.01, -0.02]] * 2, atol=1e-6)


def test_an_exactly_delayed_input_is_recovered_to_a_thousandth():
    # The stick is a lagged step: what its spline and its straight lines differ by is O(h²).
    fit = output_error(off(), [flown(seed=1, exact=True), flown(seed=2, exact=True)])
    assert relative_error(fit).max() < 1e-3


def test_without_delay_simulation_agrees_with_the_state_space_model():
    model = replace(TRUTH, tau=0.0)
    record = flown(seed=3)
    x0, bias = np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    y = simulate(model, record, x0, bias)
    expected = model.system().simulate(record.t, record.u, x0) + bias
    np.testing.assert_allclose(y, expected, rtol=1e-9, atol=1e-9)  # rounding over 600 steps


@pytest.mark.parametrize("interval", [0.3, 2.0, 100.0])
def test_the_interval_does_not_move_the_estimate(interval):
    sigma = {"ay": 0.05, "p": 0.005, "phi": 0.005}
    records = [flown(seed=1).with_noise(sigma, np.random.default_rng(4))]
    reference = output_error(TRUTH, records)
    fit = output_error(TRUTH, records, interval=interval)
    # Same optimum, solver tolerance 1e-8 relative to a curvature of order one.
    std = np.array([row.std_error for row in reference.parameters])
    assert np.abs((fit.model.vector() - reference.model.vector()) / std).max() < 1e-3
    np.testing.assert_allclose(fit.cost, reference.cost, rtol=1e-8)
    np.testing.assert_allclose([row.std_error for row in fit.parameters], std, rtol=1e-4)


def test_noise_covariance_and_parameters_come_out_within_their_scatter():
    sigma = np.array([0.05, 0.005, 0.005])
    noise = dict(zip(TRUTH.outputs, sigma, strict=True))
    rng = np.random.default_rng(5)
    fit = output_error(off(), [flown(seed=s).with_noise(noise, rng) for s in (1, 2, 3)])
    z = [(row.value - getattr(TRUTH, row.name)) / row.std_error for row in fit.parameters]
    assert np.max(np.abs(z)) < 4
    # 1800 samples: a standard deviation scatters by 1/√(2·1800) = 1.7 %.
    np.testing.assert_allclose(np.sqrt(np.diag(fit.R)), sigma, rtol=4 * 0.017)


def test_an_iteration_limit_is_an_error_that_carries_the_best_fit():
    with pytest.raises(ConvergenceError, match="iteration limit") as caught:
        output_error(off(), [flown(seed=1)], options=SolverOptions(max_iterations=2))
    assert not caught.value.best.success
    assert np.isfinite(caught.value.best.model.vector()).all()
