"""What the records determine, and what they do not."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from truths.closed_roll import (
    NOISE,
    TRUTH,
    Roll,
    excitation,
    noisy,
    with_holes,
    with_response,
)

from casid import Constraint, ConvergenceError, Model, Record, Scalar, parameter
from casid.free import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.output_error import output_error
from casid.shooting.precision import precision
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import starting_programme


class Twin(Roll):
    """Two parameters that only show as a sum."""

    Lextra: Scalar = parameter(default=0.5, lower=-10.0, upper=10.0, unit="rad/s^2")

    def B(self):
        return [[self.Ylat, 0], [self.Llat + self.Lextra, self.Lped], [0, 0]]


def test_a_fit_may_end_with_its_only_free_parameter_on_a_bound():
    lowest, others = {"tau": (0.09, 0.2)}, set(TRUTH.parameter_names()) - {"tau"}  # of 0.075 s
    fit = output_error(TRUTH, [noisy()], fixed=others, bounds=lowest)
    assert fit.success
    assert fit["tau"].value == pytest.approx(0.09)
    assert fit["tau"].active
    assert np.isnan(fit["tau"].std_error)
    assert fit.notes.collinear == ()


@pytest.mark.second
@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_parameters_that_show_only_together_are_named(domain):
    with pytest.raises(ConvergenceError, match="do not determine Llat, Lextra") as caught:
        output_error(Twin(), [noisy()], domain=domain)
    best = caught.value.best
    assert np.isinf(best["Llat"].std_error)
    assert np.isinf(best["Lextra"].std_error)
    assert best["Lp"].std_error < 0.1
    assert best["Llat"].value + best["Lextra"].value == pytest.approx(TRUTH.Llat, rel=0.01)
    alone = output_error(Twin(), [noisy()], fixed=("Lextra",), domain=domain)
    assert alone.success
    for name in set(alone.free_names) - {"Llat"}:  # errors are those of the same likelihood
        assert best[name].std_error == pytest.approx(alone[name].std_error, rel=0.01), name


class Hidden(Roll):
    """A state that no output feels, with a pole of its own."""

    states = (*Roll.states, "h")
    pole: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/s")

    def A(self):
        return [*([*row, 0] for row in super().A()), [0, 1, 0, self.pole]]

    def B(self):
        return [*super().B(), [1, 0]]

    def C(self):
        return [[*row, 0] for row in super().C()]


def test_what_no_output_feels_is_named_whatever_rounding_says():
    others = {*TRUTH.parameter_names()} - {"Llat"}
    with pytest.raises(ConvergenceError, match="the records do not determine pole here") as caught:
        output_error(Hidden(), [noisy()], fixed=others)
    best = caught.value.best
    assert np.isinf(best["pole"].std_error)
    assert not best.success
    assert best["Llat"].std_error < 1.0


def test_a_control_that_never_moves_is_named_and_the_rest_estimated():
    record = noisy()
    still = replace(record, u=record.u * [1, 0])
    with pytest.raises(ConvergenceError, match=r"do not determine Lped .* add a manoeuvre"):
        output_error(TRUTH, [still])


@pytest.mark.second
def test_culprits_of_a_near_singular_information_are_named():
    record = noisy()
    pedal_as_stick = 0.5 * record.u[:, :1] + 0.002 * excitation(record.t, 9)[:, 1:]
    record = replace(record, u=np.hstack([record.u[:, :1], pedal_as_stick]))
    record = with_response(record, TRUTH).with_noise(NOISE, np.random.default_rng(2))
    fit = output_error(TRUTH, [record], fixed=("tau",))
    worst = fit.notes.collinear[0]
    assert {"Llat", "Lped"} <= set(worst.names)
    assert not {"Yv", "Lv", "Ylat"} & set(worst.names)
    assert worst.condition > 30
    names = list(fit.free_names)
    i, j = names.index("Llat"), names.index("Lped")
    assert fit.notes.correlation[i][j] < -0.9  # what one takes the other gives
    assert output_error(TRUTH, [noisy()]).notes.collinear == ()


@pytest.mark.second
def test_an_exactly_singular_factor_is_told_with_the_best_fit(monkeypatch):
    def singular(*_):
        raise RuntimeError("Factor is exactly singular")

    monkeypatch.setattr("casid.shooting.uncertainty.eliminate", singular)
    with pytest.raises(ConvergenceError, match="do not determine Yv") as caught:
        output_error(TRUTH, [noisy()])
    best = caught.value.best
    assert not best.success
    assert best.model.Lp == pytest.approx(TRUTH.Lp, rel=0.1)
    assert all(np.isinf(row.std_error) for row in best.parameters)


class Beyond(Roll):
    """A constraint that no value within the bounds keeps."""

    def constraints(self):
        return [Constraint("steep", self.Llat, 1e3, np.inf)]


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize(
    "settings", [{}, {"domain": "frequency"}, {"process_noise": True}], ids=str
)
def test_a_constraint_that_contradicts_bounds_is_named(settings):
    with pytest.raises(
        ConvergenceError, match=r"'steep' is .*, wanted between 1000 and inf; .* bou"
    ):
        output_error(Beyond(), [noisy().between(0, 5)], bounds={"Llat": (0, 60)}, **settings)


class Loaded(type(TRUTH)):
    """Roll with constant forces, as the response to a third input that never moves."""

    inputs = ("lat", "ped", "one")

    L0: Scalar = parameter(default=0.0, unit="rad/s^2")
    Y0: Scalar = parameter(default=0.0, unit="m/s^2")

    def B(self):
        return [[self.Ylat, 0, self.Y0], [self.Llat, self.Lped, self.L0], [0, 0, 0]]

    def D(self):
        return [[self.Ylat, 0, 0], [0, 0, 0], [0, 0, 0]]


@pytest.mark.second
def test_constant_forces_beside_output_biases_are_not_determined_and_no_success():
    # A shift of the states, taken back by biases and initial states, is a constant force.
    records = [
        replace(r, u=np.column_stack([r.u, np.ones(r.N)]), inputs=Loaded.inputs)
        for r in (noisy(1), noisy(2))
    ]
    with pytest.raises(ConvergenceError, match="do not determine L0, Y0") as caught:
        output_error(Loaded(), records)
    best = caught.value.best
    assert not best.success
    assert np.isinf([best["L0"].std_error, best["Y0"].std_error, best["Y0"].cramer_rao]).all()
    alone = output_error(TRUTH, [noisy(1), noisy(2)])
    for row in alone.parameters:  # the others are as if the forces were not there
        assert best[row.name].value == pytest.approx(row.value, abs=1e-3 * row.std_error)
        assert best[row.name].std_error == pytest.approx(row.std_error, rel=1e-3)
    known = output_error(Loaded(), records, biases=False)
    assert np.isfinite([row.std_error for row in known.parameters]).all()


class Slow(Model):
    """One stable mode."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a: Scalar = parameter(default=-1.0, lower=-10.0, upper=0.0, unit="1/s")
    b: Scalar = parameter(default=1.0, unit="1/s")

    def A(self):
        return [[self.a]]

    def B(self):
        return [[self.b]]


@pytest.mark.second
def test_a_mode_that_makes_a_ramp_of_growth_is_no_solution():
    # It grows, which no a ≤ 0 does: near zero initial state and bias make a parabola of it.
    t, rng = 0.05 * np.arange(200), np.random.default_rng(0)
    u = np.where((t > 1) & (t < 3), 1.0, 0.0) - np.where((t > 4) & (t < 5), 1.0, 0.0)
    x = scipy.signal.lsim(([[0.05]], [[3.0]], [[1.0]], [[0.0]]), u, t)[1]
    y = (x + 0.02 * rng.standard_normal(200))[:, None]
    record = Record(t, u[:, None], y, ("u",), ("x",), "slow")
    with pytest.raises(ConvergenceError, match="the biases of x diverge together"):
        output_error(Slow(), record)
    fit = output_error(Slow(), record, biases=False)
    assert fit["a"].active
    assert fit["a"].value == 0.0


class Distance(Slow):
    """It and its integral, far from the origin of whatever map."""

    states, outputs = ("x", "s"), ("x", "s")

    def A(self):
        return [[self.a, 0], [1, 0]]

    def B(self):
        return [[self.b], [0]]


@pytest.mark.second
@pytest.mark.parametrize("origin", [0.0, pytest.param(1e5, marks=pytest.mark.campaign), 5.4e6])
def test_a_constant_that_a_bias_takes_up_changes_nothing(origin):
    # It is a bias or where the integral begins, and however large it is, noise is as small.
    t, rng = 0.1 * np.arange(300), np.random.default_rng(1)
    u = np.sign(np.sin(0.7 * t)) * (t > 1)
    system = ([[-0.4, 0], [1, 0]], [[2.0], [0.0]], np.eye(2), np.zeros((2, 1)))
    y = scipy.signal.lsim(system, u, t)[1] + rng.standard_normal((300, 2)) * [0.5, 0.02]
    record = Record(t, u[:, None], y + np.array([0, origin]), ("u",), ("x", "s"), "r")
    fit = output_error(Distance(), record)
    np.testing.assert_allclose(np.sqrt(np.diag(fit.R)), [0.5, 0.02], rtol=0.15)
    assert abs(fit["a"].value + 0.4) < 3 * fit["a"].std_error < 0.003


def test_information_is_that_of_least_squares_with_all_else_projected_out():
    # One interval: residuals of λ, the initial state and the biases, by differences.
    record, R = with_holes(noisy().between(0, 4)), np.diag([0.05, 0.005, 0.005]) ** 2
    free = free_parameters(TRUTH)
    evaluator = Evaluator(free, lay_out([record], 1e9))
    programme, point = starting_programme(evaluator, free, R, True)
    x = programme.pack(point)
    whiten = np.sqrt(np.diag(np.linalg.inv(R)))

    def residuals(x):
        return (evaluator.simulate(programme.unpack(x)).residuals * whiten).ravel()

    h = 1e-6
    J = np.transpose([(residuals(x + h * e) - residuals(x - h * e)) / (2 * h) for e in
                      np.eye(len(x))])  # fmt: skip
    n = len(free.index)
    own, rest = J[:, :n], J[:, n:]
    projected = own - rest @ np.linalg.lstsq(rest, own, rcond=None)[0]
    covariance = np.linalg.inv(projected.T @ projected)
    found = precision(programme, x, np.zeros(n), np.zeros(0))[1]
    unit = np.outer(programme.scales.lam[:n], programme.scales.lam[:n])
    np.testing.assert_allclose(found.cramer_rao, covariance * unit, rtol=1e-4)
    alone = 1 / np.linalg.norm(projected, axis=0)
    np.testing.assert_allclose(found.insensitivity, alone * programme.scales.lam[:n], rtol=1e-5)
    assert found.undetermined == ()


@pytest.mark.second
def test_errors_allow_for_what_the_fit_took_from_the_residuals():
    record = noisy(2)
    free = output_error(TRUTH, record)
    known = output_error(TRUTH, record, R=free.R)
    n = np.isfinite(record.y).sum()
    p = 7 + 3 + 3  # parameters, initial states and biases
    # Where the residuals gave R it is n/(n - p) too small; a given one is right.
    np.testing.assert_allclose(free.covariance / known.covariance, n / (n - p), rtol=1e-5)
    np.testing.assert_allclose(free.notes.cramer_rao, known.notes.cramer_rao, rtol=1e-5)


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.filterwarnings("ignore:output error in the frequency domain")  # of few lines
@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_bounds_and_constraints_that_do_not_bind_change_nothing_however_wide_they_are(domain):
    records = [noisy(seed) for seed in (2, 3)]
    plain = output_error(TRUTH, records, domain=domain)
    name = max(plain.free_names, key=lambda each: plain[each].value)
    value = plain[name].value
    wide = output_error(TRUTH, records, domain=domain, bounds={name: (0.0, 1e6 * value)})
    assert not wide[name].active
    for row in plain.parameters:
        assert abs(wide[row.name].value - row.value) < 0.01 * row.std_error
        assert wide[row.name].std_error == pytest.approx(row.std_error, rel=1e-3)
    for unit in (1e-8, 1.0, 1e8):
        for most, active in ((1.2 * value, False), (0.9 * value, True)):
            held = output_error(_limited(name, unit, most), records, domain=domain)
            (row,) = held.constraints
            assert row.active == active
            if active:  # as its own bound holds it
                bound = output_error(TRUTH, records, domain=domain, bounds={name: (0.0, most)})
                assert row.multiplier * unit == pytest.approx(bound[name].multiplier, rel=2e-3)
            for each in (bound if active else plain).parameters:
                near = 0.01 * (plain[each.name].std_error)
                assert abs(held[each.name].value - each.value) < near
                np.testing.assert_allclose(held[each.name].std_error, each.std_error, rtol=1e-3)


def _limited(name, unit, most):
    class Limited(type(TRUTH)):
        def constraints(self):
            return (
                Constraint("most", unit * getattr(self, name), upper=unit * most, lower=-np.inf),
            )

    return Limited(**{each: getattr(TRUTH, each) for each in TRUTH.parameter_names()})
