"""Output error of nonlinear structures."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy
from truths.motor import DEVIATION, Motor, answered, climbed
from truths.swing import TRUTH, SmallSwing, Swing, WrittenOut, integrated, steps, swung

from casid import (
    ConvergenceError,
    DataWarning,
    ModelError,
    NonlinearModel,
    OutputError,
    Record,
    Scalar,
    output_error,
    parameter,
)
from casid.free import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.sensitivity import Point, whiteners


def small(hold, irregular, M=6.0):
    """A record of the linear pendulum, and its name in words."""
    rng = np.random.default_rng(5)
    t = 0.04 * np.arange(400) + (0.008 * rng.uniform(-1, 1, 400) if irregular else 0.0)
    u = steps(3, t - t[0], 0.4)
    truth = SmallSwing(Mq=-0.8, M=M, Mlon=8.0, tau=0.073)
    y = truth.system().simulate(t, u, hold=hold)
    y = y + 0.02 * rng.standard_normal(y.shape)
    y[rng.random(y.shape) < 0.1] = np.nan
    return Record(t, u, y, ("lon",), ("q", "theta"), "small", hold)


@pytest.mark.second
@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("irregular", [False, True])
def test_a_linear_structure_written_as_a_nonlinear_one_gives_the_same_estimates(hold, irregular):
    record = small(hold, irregular)
    linear, written = output_error(SmallSwing(), record), output_error(WrittenOut(), record)
    for name in SmallSwing.parameter_names():
        error = linear[name].std_error
        assert abs(written[name].value - linear[name].value) < 0.01 * error
        assert written[name].std_error == pytest.approx(error, rel=1e-3)
    assert written.notes.integration.shift < 0.02


@pytest.mark.second
def test_an_unstable_structure_is_no_harder():
    record = small("foh", irregular=False, M=-0.5).cut(0, 5)
    linear, written = output_error(SmallSwing(), record), output_error(WrittenOut(), record)
    assert linear["M"].value < 0
    for name in SmallSwing.parameter_names():
        assert abs(written[name].value - linear[name].value) < 0.01 * linear[name].std_error


@pytest.mark.parametrize("substeps", [1, 2])
def test_gram_matrices_are_those_of_differences_of_the_residuals(substeps):
    record = swung(2, duration=3.0)
    free, R = free_parameters(TRUTH), np.diag([0.1, 0.05]) ** 2
    evaluator = NonlinearEvaluator(free, lay_out([record], 1.5), substeps)
    nodes = np.array([[0.0, 0.1], [0.4, 0.8]])
    bias = np.array([[0.1, 0.2]])
    whiten = 1 / np.sqrt(np.diag(R))

    def whitened(z):
        point = Point(lam=z[:4], nodes=nodes + z[4:6], bias=bias + z[6:])
        motion = evaluator.simulate(point)
        return np.concatenate([(motion.residuals * whiten).ravel(), motion.ends.ravel()])

    z, step = np.concatenate([free.guess, np.zeros(4)]), 1e-6
    J = np.array([(whitened(z + d) - whitened(z - d)) / (2 * step) for d in step * np.eye(8)]).T
    point = Point(lam=free.guess, nodes=nodes, bias=bias)
    sweep = evaluator.sweep(point, evaluator.simulate(point), whiteners(R, evaluator.layout))
    gram, slopes = np.zeros((9, 9)), np.zeros((2, 2, 8))
    for batch in sweep.batches():
        gram, slopes[batch.index] = gram + batch.gram.sum(axis=0), batch.slopes
    r = whitened(z)[:-4]
    rows = np.column_stack([J[:-4], r])
    np.testing.assert_allclose(gram, rows.T @ rows, rtol=1e-5, atol=1e-6 * np.abs(gram).max())
    np.testing.assert_allclose(slopes.reshape(4, 8), J[-4:], atol=1e-6 * np.abs(J[-4:]).max())


@pytest.mark.second
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_estimates_are_those_of_least_squares_over_solve_ivp(hold):
    record = swung(7, duration=2.4, dt=0.08, hold=hold)
    R = np.diag([0.02, 0.02]) ** 2
    estimator = OutputError(R=R, biases=False, interval=0.8)
    fit = estimator.fit(Swing(), record, fixed=("tau",), bounds={"tau": (0.05, 0.05)})
    fixed = replace(TRUTH, tau=0.05)

    def residuals(z):
        model = replace(fixed, Mq=z[0], M=z[1], Mlon=z[2])
        y = integrated(model, record.t, record.u, hold, z[3:], tolerance=1e-11)
        return ((y - record.y) / 0.02).ravel()

    start = [*fit.model.vector()[:3], *fit.initial_states[0]]
    found = scipy.optimize.least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    for value, name in zip(found.x, ("Mq", "M", "Mlon"), strict=False):
        assert abs(fit[name].value - value) < 1e-4 * fit[name].cramer_rao


@pytest.mark.second
def test_halving_the_steps_changes_what_is_reported():
    record = swung(4, dt=0.1)
    with pytest.warns(DataWarning, match="1 integration step within 0.1 s move tau by 0.057"):
        coarse = OutputError(steps=1).fit(Swing(), record)
    fine = OutputError(steps=2).fit(Swing(), record)
    moved = {n: (fine[n].value - coarse[n].value) / fine[n].cramer_rao for n in coarse.free_names}
    told = coarse.notes.integration
    assert told.steps == 1
    assert told.moved == max(moved, key=lambda name: abs(moved[name]))
    assert told.shift == pytest.approx(abs(moved[told.moved]), rel=0.05)
    chosen = output_error(Swing(), record).notes.integration
    assert chosen.steps > 1
    assert chosen.shift <= 1e-4


def test_settings_that_the_structure_does_not_have_are_told():
    record = swung(1)
    with pytest.raises(ValueError, match="process_noise: a nonlinear structure has no filter"):
        output_error(Swing(), record, process_noise=True)
    with pytest.raises(ValueError, match="steps=0: expected 1 to"):
        OutputError(steps=0).fit(Swing(), record)
    with pytest.raises(ValueError, match="steps=2: a linear structure"):
        OutputError(steps=2).fit(SmallSwing(), record)


@pytest.mark.second
def test_totals_are_estimated_from_whatever_was_subtracted_as_trim():
    record = swung(1)
    shifted = record.detrend("mean")
    given, detrended = output_error(Swing(), record), output_error(Swing(), shifted)
    np.testing.assert_allclose(detrended.model.vector(), given.model.vector(), rtol=1e-7)


@pytest.mark.second
def test_a_motor_of_eighty_radians_a_second_is_estimated_as_by_least_squares():
    record = climbed(seed=3)  # from the first solution n falls from its mirror image, through zero
    estimator = OutputError(R=DEVIATION**2 * np.eye(1), biases=False)
    fit = estimator.fit(Motor(), record)
    names = ("Zw", "Z", "lag")

    def residuals(z):
        w = answered(z[:3], record.t, record.u[:, 0], z[3:])
        return (w - record.y[:, 0]) / DEVIATION

    start = [*(fit[name].value for name in names), *fit.initial_states[0]]
    found = scipy.optimize.least_squares(
        residuals, start, x_scale=np.abs(start) + 0.01, diff_step=1e-5, xtol=1e-12, ftol=1e-12
    )
    for value, name in zip(found.x, names, strict=False):
        assert abs(fit[name].value - value) < 1e-2 * fit[name].cramer_rao
    assert abs(fit["lag"].value - 1 / 80) < 4 * fit["lag"].cramer_rao
    assert fit.initial_states[0, 1] > 0


def test_a_mode_too_fast_for_the_integration_is_named():
    with pytest.raises(ModelError, match=r"-1e\+05 1/s, mostly of n, .*64 steps.* steady state"):
        output_error(Motor(lag=1e-5), climbed(), fixed=("lag",))


class Stalled(NonlinearModel):
    """V' = T - drag sqrt(V - 2), which has no value below 2 m/s."""

    states, inputs, outputs = ("V",), ("T",), ("V",)

    drag: Scalar = parameter(default=1.0, lower=0.0, upper=5.0, unit="-")

    def derivatives(self, x, u):
        return [u.T - self.drag * ca.sqrt(x.V - 2)]

    def reference(self):
        return {"V": 6.0, "T": 2.0}


def test_a_node_where_an_equation_has_no_value_is_named_with_what_is_there():
    t = 0.05 * np.arange(200)
    y = np.full((200, 1), 6.0)
    y[100:110] = 0.5
    low = Record(t, np.full((200, 1), 2.0), y, ("T",), ("V",), "low")
    told = r"dV/dt is no number in record 'low' at 5 s, where V = 0.5, T = 2 \(write an equation"
    with pytest.raises(ConvergenceError, match=told) as failed:
        output_error(Stalled(), low, biases=False, interval=0.5)
    assert failed.value.best.model == Stalled()


def test_a_condition_where_an_equation_has_no_value_is_named():
    with pytest.raises(ModelError, match=r"'V' is nan at V = 1, T = 2; .* .casadi.sin, not math"):
        Stalled().at({"V": 1.0, "T": 2.0})
