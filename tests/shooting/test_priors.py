"""Prior values against Bayes' rule, constants of states against what was flown."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lsim
from truths.structures import Banking

from casid import (
    DataWarning,
    ModelError,
    NonlinearModel,
    OutputError,
    Record,
    Scalar,
    StateSpace,
    output_error,
    parameter,
)
from casid.free import free_parameters
from casid.shooting.likelihood import Noise
from casid.shooting.priors import Knowledge, in_totals
from casid.shooting.sensitivity import Point

FLOWN = (0.02, -0.05)  # constants in p' of the two records
SIGMA = 0.003


def flown(constants=FLOWN, seed=0):
    """Records of Lp = -2.2, Llat = 12, from rest, with a constant in p'."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, 12, 0.04)
    u = (0.05 * np.sign(np.sin(1.3 * t)) * (t > 1))[:, None]
    truth = StateSpace([[-2.2, 0], [1, 0]], [[12.0, 1], [0, 0]], np.eye(2), np.zeros((2, 2)))
    noise = SIGMA * rng.standard_normal((len(constants), len(t), 2))
    y = [truth.simulate(t, np.hstack([u, np.full_like(u, b)])) for b in constants]
    columns = ("lat",), ("p", "phi")
    return [Record(t, u, each, *columns, f"flight {k}") for k, each in enumerate(y + noise)]


def test_constants_of_states_are_found_in_every_record():
    fit = OutputError(state_biases=("p",), biases=False).fit(Banking(), flown())
    np.testing.assert_allclose(fit.state_biases[:, 0], FLOWN, atol=5e-4)
    for name, true in (("Lp", -2.2), ("Llat", 12.0)):
        assert abs(fit[name].value - true) < 3 * fit[name].std_error
    assert fit.initial_states.shape == (2, 2)
    assert type(fit.model) is Banking
    np.testing.assert_array_less(np.abs(fit.biases), 2e-4)


class RollWritten(NonlinearModel):
    """`Banking` as equations, and as a class that asks its own states."""

    states, inputs, outputs = Banking.states, Banking.inputs, Banking.outputs

    Lp: Scalar = parameter(default=-3.0, lower=-25.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=10.0, lower=0.0, upper=60.0, unit="rad/s^2")

    def derivatives(self, x, u):
        p, _ = (getattr(x, name) for name in self.states)
        return [self.Lp * p + self.Llat * u.lat, p]


@pytest.mark.second
def test_constants_of_a_nonlinear_structure_are_those_of_the_linear_one():
    estimator = OutputError(state_biases=("p",), biases=False)
    linear, fit = (estimator.fit(model, flown()) for model in (Banking(), RollWritten()))
    assert type(fit.model) is RollWritten
    assert fit.initial_states.shape == (2, 2)
    np.testing.assert_allclose(fit.state_biases, linear.state_biases, atol=2e-6)
    for name in ("Lp", "Llat"):
        assert abs(fit[name].value - linear[name].value) < 0.01 * linear[name].std_error
        assert fit[name].std_error == pytest.approx(linear[name].std_error, rel=1e-3)


def test_what_is_added_is_gradient_and_hessian_of_the_cost():
    free = free_parameters(Banking(), (), None, {"Lp": (-2.0, 0.5)})
    free = replace(free, initial={"p": (0.1, 0.2), "phi": ("trim", 0.5)}, unbiased=("p", "phi"))
    begun = [
        in_totals(replace(record, trim={"phi": phi}), free.initial)
        for record, phi in zip(flown(), (0.1, -0.3), strict=True)
    ]
    noise = Noise(np.ones((1, 2), dtype=bool), np.array([9]), np.array([30.0, 70.0]))
    knowledge = Knowledge(free, noise, np.array([0, 0, 1]), begun)
    rng = np.random.default_rng(0)
    x = rng.standard_normal(2 + 2 * 2 + 3 * 2)  # parameters, biases and nodes

    def cost(x):
        return knowledge.cost(Point(x[:2], x[2:6].reshape(2, 2), x[6:].reshape(3, 2)))

    records, nodes = np.zeros((2, 6, 7)), np.zeros((3, 2, 5))
    point = Point(x[:2], x[2:6].reshape(2, 2), x[6:].reshape(3, 2))
    knowledge.add(records, nodes, point)
    slopes = (x[[6, 10]] - 0.1) / 0.2**2, (x[[7, 11]] - [0.1, -0.3]) / 0.5**2
    np.testing.assert_allclose(nodes[[0, 2], :, -1].T, slopes)
    own = [records[0, :2, -1], *records[:, 4:, -1], *nodes[:, :, -1]]
    curved = [np.diag(records[0])[:2], *(np.diag(r)[4:] for r in records),
              *(np.diag(each[:, 2:]) for each in nodes)]  # fmt: skip
    for i, h in enumerate(1e-3 * np.eye(len(x))):
        up, down = cost(x + h), cost(x - h)
        assert np.concatenate(own)[i] == pytest.approx((up - down) / 2e-3, rel=1e-6, abs=1e-6)
        bend = (up - 2 * cost(x) + down) / 1e-6
        assert np.concatenate(curved)[i] == pytest.approx(bend, rel=1e-3, abs=1e-3)


def test_records_have_the_trim_that_their_initial_states_are_said_to_have():
    with pytest.raises(ValueError, match="does not say phi"):
        OutputError(initial={"phi": ("trim", 0.1)}).fit(RollWritten(), flown())


@pytest.mark.second
def test_a_measured_state_begins_at_the_trim_that_was_subtracted():
    # An angle nothing feeds back from: its bias takes up where it begins, the derivatives stay.
    records = [record.detrend({"lat": 0.0, "p": 0.0, "phi": 0.4}) for record in flown()]
    plain = OutputError().fit(RollWritten(), records)
    trimmed = OutputError(initial={"phi": ("trim", 0.01)}).fit(RollWritten(), records)
    known = OutputError(initial={"phi": (0.4, 0.01)}).fit(RollWritten(), records)
    for name in ("Lp", "Llat"):
        assert trimmed[name].value == pytest.approx(known[name].value, rel=1e-9)
        assert trimmed[name].value == pytest.approx(plain[name].value, rel=1e-9)
    np.testing.assert_allclose(trimmed.initial_states[:, 1], 0.4, atol=1e-9)
    assert np.all(np.abs(plain.initial_states[:, 1] - 0.4) > 0.1)  # what nothing but the trim says
    with pytest.raises(ValueError, match=r"detrend it \(record.detrend"):
        OutputError(initial={"phi": ("trim", 0.1)}).fit(RollWritten(), records[0].total())


def test_outputs_named_alone_have_biases():
    records = [
        replace(record, y=record.y + np.array([0.0, 0.03])).select(outputs=("phi", "p"))
        for record in flown((0.0, 0.0))
    ]
    known = {"phi": (0.0, 1e-4), "p": (0.0, 1e-4)}
    fit = OutputError(biases=("phi",), initial=known).fit(Banking(), records)
    np.testing.assert_allclose(fit.biases[:, 1], 0.03, atol=1e-3)
    np.testing.assert_array_less(np.abs(fit.biases[:, 0]), 1e-9)
    np.testing.assert_array_less(np.abs(fit.initial_states), 4e-4)


@pytest.mark.parametrize("sigma", [1e-3, 1e-5])
def test_an_output_without_a_bias_has_none_however_small_the_noise(sigma):
    t = np.arange(0, 12, 0.04)
    u = 0.05 * np.where(t > 1, 1 + 0.3 * np.sin(1.3 * t), 0.0)

    def flight(unknown):
        A, B = [[unknown[0], 0], [1, 0]], [[unknown[1]], [0]]
        y = lsim((A, B, np.eye(2), np.zeros((2, 1))), u, t, [unknown[2], 0])[1]
        return (y + np.array([0, unknown[3]])).ravel()  # a bias of phi and none of p

    true = np.array([-2.2, 12.0, 0.01, 0.002])
    y = flight(true) + sigma * np.random.default_rng(1).standard_normal(2 * len(t))
    found = least_squares(lambda x: (flight(x) - y) / sigma, true, "3-point", xtol=1e-14)
    error = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    record = Record(t, u[:, None], y.reshape(-1, 2), ("lat",), ("p", "phi"))
    by = OutputError(biases=("phi",), initial={"phi": (0.0, 1e-9)}, R=np.eye(2) * sigma**2)
    fit = by.fit(Banking(), record)
    for name, value, of in zip(("Lp", "Llat"), found.x, error, strict=False):
        assert abs(fit[name].value - value) < 1e-2 * of
        assert fit[name].cramer_rao == pytest.approx(of, rel=1e-3)


def test_prior_and_records_are_weighed_by_their_information():
    records, R = flown((0.0, 0.0)), SIGMA**2 * np.eye(2)
    alone = OutputError(R=R).fit(Banking(), records)
    prior, std = alone["Lp"].value - 0.004, 1.5 * alone["Lp"].cramer_rao
    fit = OutputError(R=R, priors={"Lp": (prior, std)}).fit(Banking(), records)
    F = np.linalg.inv(alone.notes.cramer_rao)
    posterior = np.linalg.inv(F + np.diag([std**-2, 0.0]))  # Bayes, for a likelihood that is normal
    values = np.array([alone[name].value for name in alone.free_names])
    expected = posterior @ (F @ values + [prior / std**2, 0.0])
    np.testing.assert_allclose([row.value for row in fit.parameters], expected, rtol=2e-5)
    np.testing.assert_allclose(fit.notes.cramer_rao, posterior, rtol=1e-2)
    assert fit["Lp"].std_error < alone["Lp"].std_error
    assert (fit["Lp"].prior, fit["Lp"].prior_std) == (prior, std)
    assert np.isnan(fit["Llat"].prior)


@pytest.mark.second
def test_a_prior_that_the_records_contradict_is_told_and_one_they_bear_out_is_not(recwarn):
    records, R = flown((0.0, 0.0)), SIGMA**2 * np.eye(2)
    alone = OutputError(R=R).fit(Banking(), records)["Lp"]
    near = alone.value + 3.0 * np.hypot(alone.cramer_rao, 0.1), 0.1
    OutputError(R=R, priors={"Lp": near}).fit(Banking(), records)
    assert not [each for each in recwarn if "contradict" in str(each.message)]
    far = alone.value + 5.0 * alone.cramer_rao * np.sqrt(2), alone.cramer_rao
    # As good as the records: their difference has √2 times the deviation of either.
    with pytest.warns(DataWarning, match=r"contradict the prior Lp.* lies (4\.9|5\.[01]) standard"):
        OutputError(R=R, priors={"Lp": far}).fit(Banking(), records)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"priors": {"Lq": (1.0, 0.1)}}, "no parameter 'Lq'"),
        ({"priors": {"Lp": (1.0, 0.0)}}, "deviation above 0"),
        ({"initial": {"q": (0.0, 1.0)}}, "initial names 'q'"),
        ({"biases": ("r",)}, "biases names 'r'"),
        ({"state_biases": ("r",)}, "state_biases names 'r'"),
        ({"initial": {"p": ("trim", 0.1)}}, r"write \(0.0, 0.1\)"),
        ({"initial": {"p": ("trim", 0.0)}}, "deviation above 0"),
        ({"initial": {"p": (0.0, 1e-14)}}, "p: .* of 1e-14, .* give a deviation of 1e-12 or more"),
    ],
)
def test_what_is_said_to_be_known_is_checked(settings, message):
    with pytest.raises(ModelError, match=message):
        OutputError(**settings).fit(Banking(), flown())


def test_a_prior_is_of_a_free_parameter_and_within_its_bounds():
    prior = {"Lp": (-2.0, 0.1)}
    for held in ({"fixed": ("Lp",)}, {"bounds": {"Lp": (-2.0, -2.0)}}):
        with pytest.raises(ModelError, match="Lp is fixed and has a prior"):
            output_error(Banking(), (), priors=prior, **held)
    outside = pytest.warns(DataWarning, match=r"prior of Lp, -2, lies outside its bounds \[-1, 0\]")
    with outside, pytest.raises(ValueError, match="no records"):
        output_error(Banking(), (), priors=prior, bounds={"Lp": (-1.0, 0.0)})
