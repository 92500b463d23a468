"""Starts of the output-error programme."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
import scipy.signal
from scipy.linalg import expm
from truths.closed_roll import NOISE, TRUTH, flown

from casid.free import free_parameters
from casid.shooting.innovation import starting_noises
from casid.shooting.intervals import lay_out
from casid.shooting.output_error import OutputError
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import (
    accumulated,
    channel_size,
    continued_programme,
    neighbouring_programme,
    starting_programme,
)


def test_accumulated_covariance_is_its_integral_for_stiff_and_unstable_dynamics():
    A, Q = np.array([[-30.0, 5.0], [0.0, 0.4]]), np.array([[1.0, 0.2], [0.2, 2.0]])

    def rate(s, i, j):
        return (expm(A * s) @ Q @ expm(A.T * s))[i, j]

    found = accumulated(A, Q, 3.0)
    for i, j in np.ndindex(2, 2):
        expected = scipy.integrate.quad(rate, 0, 3, args=(i, j), limit=500)[0]
        np.testing.assert_allclose(found[i, j], expected, rtol=1e-9)
    # The exponential of the whole span would lose all digits: e^{30·20} beside e^{-30·20}.
    assert np.linalg.eigvalsh(accumulated(np.diag([-30.0, -1.0]), Q, 20.0)).min() > 0


def test_the_size_of_a_channel_is_that_of_its_measured_samples_about_the_level():
    y = np.array([[3.0, 5.0, 1.0], [5.0, 0.0, 1.0], [1.0, 9.0, 1.0]])
    patterns = np.array([[True, True, True], [True, False, True]])
    layout = SimpleNamespace(y=y, patterns=patterns, pattern=np.array([0, 1, 0]))
    found = channel_size(SimpleNamespace(layout=layout, level=lambda: (0.0, np.array([1, 2, 1]))))
    np.testing.assert_allclose(found, [np.sqrt((4 + 16 + 0) / 3), np.sqrt((9 + 49) / 2), 1.0])


@pytest.mark.parametrize("filtering", [False, True])
def test_a_start_follows_the_data_from_the_guess_and_its_noise_is_what_it_leaves(filtering):
    records, free = [flown(seed=k).between(0, 3) for k in (1, 2)], free_parameters(TRUTH)
    noises = starting_noises(TRUTH, records, "diagonal") if filtering else None
    evaluator = Evaluator(free, lay_out(records, 1.0), noises)
    programme, point = starting_programme(evaluator, free, "diagonal", True)
    nf = len(free.index)
    np.testing.assert_array_equal(point.lam[:nf], free.guess)
    motion = evaluator.simulate(point)
    left = np.mean(motion.residuals**2, axis=0)
    assert (left < 0.5 * channel_size(evaluator) ** 2).all()  # at rest all would be left
    wanted = np.ones(evaluator.ny) if filtering else left  # a filter has its own, scaled later
    np.testing.assert_allclose(np.diag(programme.noise.given), wanted, rtol=1e-6)
    x = programme.pack(point)
    again, other = continued_programme(evaluator, free, "diagonal", programme, x)
    np.testing.assert_allclose(other.lam[:nf], free.guess, rtol=1e-12)
    at = np.sort(evaluator.layout.start)
    np.testing.assert_allclose(other.nodes, programme.values(x).motion.states[at])
    np.testing.assert_allclose(np.diag(again.noise.given), wanted, rtol=0.5)


def test_beside_a_fit_nodes_are_states_of_its_motion_which_is_as_likely():
    still = replace(TRUTH, tau=0.0)
    records = [
        flown(still, seed=k).between(0, 4).with_noise(NOISE, np.random.default_rng(k))
        for k in (1, 2)
    ]
    estimator = OutputError(interval=2.0, state_biases=("v",))
    near = estimator.fit(still, records, fixed=["tau"])
    free = estimator.free(still, fixed=["tau"])
    evaluator = Evaluator(free, lay_out(records, 0.5))
    programme, point = neighbouring_programme(evaluator, free, "diagonal", True, near)
    np.testing.assert_array_equal(point.bias, near.biases)
    m, first = near.model.system(), 0
    for number, record in enumerate(records):
        u = np.column_stack([record.u, np.full(record.N, near.state_biases[number, 0])])
        system = m.A, np.column_stack([m.B, np.eye(len(m.A))[0]]), m.A, 0 * u[: len(m.A)]
        begin = near.initial_states[number]
        linear = record.hold == "foh"
        states = scipy.signal.lsim(system, u, record.t, begin, interp=linear)[2]
        mine = np.sort(evaluator.layout.start[evaluator.layout.record == number]) - first
        nodes = point.nodes[evaluator.layout.record[np.argsort(evaluator.layout.node)] == number]
        np.testing.assert_allclose(nodes[:, : len(m.A)], states[mine], rtol=1e-6, atol=1e-9)
        first += record.N
    values = programme.values(programme.pack(point))
    np.testing.assert_allclose(values.g, 0, atol=1e-9)
    assert programme.n * values.cost == pytest.approx(near.cost, rel=1e-9)


@pytest.mark.parametrize("missing", ["records", "initial_states", "R"])
def test_beside_a_fit_of_other_records_or_without_motion_nodes_follow_the_data(missing):
    free = free_parameters(TRUTH)
    one = flown(seed=1).between(0, 4)
    other = flown(seed=2, x0=(-3.0, 0.2, -0.3)).between(0, 4)  # begins elsewhere
    near = OutputError().fit(TRUTH, [one.with_noise(NOISE, np.random.default_rng(1))])
    evaluator = Evaluator(free, lay_out([other if missing == "records" else one], 0.5))
    if missing != "records":
        near = replace(near, **{missing: None})
    found = neighbouring_programme(evaluator, free, "diagonal", True, near)
    if missing == "R":
        assert found is None
        return
    programme, point = found
    assert np.abs(programme.values(programme.pack(point)).g).max() > 1e-3  # gaps are left
    left = np.mean(evaluator.simulate(point).residuals ** 2, axis=0)
    assert (left < channel_size(evaluator) ** 2).all()
