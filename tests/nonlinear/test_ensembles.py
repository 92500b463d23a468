"""Nonlinear structures made anew, resampled and judged as such."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from truths.mixture import Inline
from truths.swing import TRUTH, SmallSwing, Swing, WrittenOut, integrated, swung

from casid import (
    Execution,
    NonlinearModel,
    Scalar,
    bootstrap,
    frequency_response,
    identifiability,
    monte_carlo,
    output_error,
    parameter,
    simulate,
)
from casid.shooting.simulation import fitting_start
from casid.structure.overview import describe

HERE = Execution(executor=Inline())
NOISE = {"q": 0.02, "theta": 0.02}


@pytest.mark.second
def test_monte_carlo_makes_its_data_with_the_nonlinear_structure():
    found = monte_carlo(TRUTH, swung(1, size=0.9), noise=NOISE, runs=4, execution=HERE)
    assert not any(found.reasons)
    # Data of the linearisation move M by dozens of its standard errors.
    assert (np.abs(found.bias) < 4 * np.nanmean(found.std_errors, axis=0) / np.sqrt(4)).all()
    assert found.names == ("Mq", "M", "Mlon", "tau")


@pytest.mark.second
def test_the_start_of_a_simulation_is_the_state_that_fits_with_biases_free():
    record = swung(2, noise=0.0)
    exact = integrated(TRUTH, record.t, record.u, "foh", [0.3, 0.5])
    start = fitting_start(TRUTH, replace(record, y=exact + np.array([0.2, 0.0])))
    assert start == pytest.approx({"q": 0.3, "theta": 0.5}, abs=1e-3)
    # placeholders for outputs tell nothing
    assert fitting_start(TRUTH, replace(record, y=0 * record.y + 5.0)) == {"q": 0.0, "theta": 0.0}


@pytest.mark.campaign
@pytest.mark.parametrize("detrended", [False, pytest.param(True, marks=pytest.mark.campaign)])
def test_a_bootstrap_puts_residuals_back_on_the_nonlinear_simulation(detrended):
    record = swung(3, size=0.9)
    record = replace(record, y=record.y + np.array([0.05, -0.1]))
    record = record.detrend("mean") if detrended else record
    fit = output_error(Swing(), record)
    found = bootstrap(fit, record, runs=3, block=0.2, execution=HERE)
    assert not any(found.reasons)
    assert (np.abs(found.bias) < 4 * np.nanmean(found.std_errors, axis=0)).all()
    with pytest.raises(ValueError, match="not estimated from these records"):
        bootstrap(fit, swung(4, size=0.9), runs=2)
    assert simulate(fit.model, record).trim == {}


class Draggy(NonlinearModel):
    """Damping by the square of the rate, which no linearisation at rest has; g1, g2 one gain."""

    states, inputs, outputs = ("q", "theta"), ("lon",), ("q", "theta")

    Mq: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/s")
    Mqq: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/rad")
    g1: Scalar = parameter(default=2.0, lower=0.1, upper=9.0, unit="-")
    g2: Scalar = parameter(default=3.0, lower=0.1, upper=9.0, unit="rad/s^2")
    off: Scalar = parameter(default=0.1, lower=-1.0, upper=1.0, unit="rad")

    def derivatives(self, x, u):
        moment = self.Mq * x.q + self.Mqq * x.q * ca.fabs(x.q) - 4.0 * ca.sin(x.theta)
        return [moment + self.g1 * self.g2 * u.lon, x.q]

    def measurements(self, x, u):  # noqa: ARG002 - all of them take inputs
        return [x.q, x.theta + self.off]


@pytest.mark.second
def test_what_is_told_apart_is_judged_along_the_record():
    found = identifiability(Draggy(), swung(1), fixed=("g2", "off"))
    assert found.identifiable
    assert found.inflation.max() < 20
    found = identifiability(Draggy(), swung(1))
    assert found.insensitive == ("off",)  # all of it a bias
    assert [set(group) for group in found.confounded] == [{"g1", "g2"}]


@pytest.mark.second
def test_information_along_a_record_is_that_of_differences_of_simulations():
    record = swung(2, duration=5.0)
    names, start = ("Mq", "M", "Mlon", "tau"), {"q": record.y[0, 0], "theta": record.y[0, 1]}
    base = np.array([*TRUTH.vector(), *start.values()])

    def answer(z):
        model = replace(TRUTH, **dict(zip(names, z, strict=False)))
        return simulate(model, record, {"q": z[4], "theta": z[5]}).y / record.y.std(axis=0)

    steps = 1e-4 * np.eye(6)
    J = np.stack([(answer(base + d) - answer(base - d)) / 2e-4 for d in steps], axis=-1)
    J = (J - J.mean(axis=0)).reshape(-1, 6)  # biases
    x0 = J[:, 4:]
    rest = J[:, :4] - x0 @ np.linalg.lstsq(x0, J[:, :4], rcond=None)[0]
    found = identifiability(TRUTH, record, spread=0.0).information
    np.testing.assert_allclose(found, rest.T @ rest, rtol=2e-2, atol=1e-3 * np.abs(found).min())


@pytest.mark.second
def test_a_structure_that_runs_away_is_judged_over_shorter_pieces():
    climbing = SmallSwing(Mq=-0.5, M=-6.0, Mlon=8.0, tau=0.07)
    found = identifiability(WrittenOut().with_values_of(climbing), swung(1, duration=40.0))
    assert found.identifiable
    with pytest.raises(ValueError, match=r"runs away.*identifiability\(model.at\(Trim"):
        identifiability(replace(TRUTH, Mq=900.0), swung(1), spread=0.0, bounds={"Mq": (-5, 1e3)})


@pytest.mark.second
def test_a_response_is_judged_at_its_flight_condition_only():
    record = swung(1)
    response = frequency_response(record)
    with pytest.raises(ValueError, match=r"one flight condition.*model.at\(Trim"):
        identifiability(TRUTH, response)
    assert identifiability(TRUTH.at({}), response).names == ("Mq", "M", "Mlon", "tau")
    overview = describe(TRUTH)
    assert overview.identifiability.identifiable
    assert "at the reference condition alone" in overview.excitation
