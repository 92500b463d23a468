from dataclasses import replace

import numpy as np
import pytest
from truths.systems import innovation_record, predictor, sampled

from casid import Record, StateSpace, pbsid
from casid.records import standard_deviations
from casid.subspace.modal import Modal, moved
from casid.subspace.prediction import (
    SampledUncertainty,
    _levelled,
    normal_equations,
    prediction_errors,
    refine_samples,
    stretches,
)


def test_prediction_errors_of_the_truth_are_its_innovations():
    system, K, record, e = innovation_record()
    su, sy = standard_deviations([record])
    data = stretches([record], su, sy, 5)
    (found,) = prediction_errors(predictor(system, K, su, sy), data, np.eye(2))
    # Initial state and constant take up five of 600 samples: errors of √(5/600) of an innovation.
    assert np.std(found * sy - (e - e.mean(axis=0))) < 0.15 * np.std(e)


def test_normal_equations_are_the_gradient_of_the_squared_errors():
    system, K, record, _ = innovation_record()
    su, sy = standard_deviations([record])
    W, weight = np.array([[1.0, 0.0], [0.4, 2.0]]), np.linspace(0.2, 3.0, record.N)[:, None]
    data = [replace(each, weight=weight) for each in stretches([record], su, sy, 5)]
    free = np.zeros((0, 2), dtype=int)
    # Away from the optimum, where the gradient is large.
    modal = predictor(StateSpace(0.95 * system.A, system.B, system.C, system.D), K, su, sy)

    def cost(model):
        return sum(float(np.sum((e @ W.T) ** 2)) for e in prediction_errors(model, data, W))

    _, downhill = normal_equations(modal, data, W, free)
    for p in range(len(downhill)):
        step = np.zeros(len(downhill))
        step[p] = 1e-5
        slope = (cost(moved(modal, step, free)) - cost(moved(modal, -step, free))) / 2e-5
        assert slope == pytest.approx(-2 * downhill[p], rel=1e-4, abs=1e-4 * np.abs(downhill).max())


def test_levelled_errors_are_of_one_size_and_their_weights_of_one_in_the_mean():
    system, K, record, _ = innovation_record()
    rough = np.where(np.arange(record.N) < 300, 0.1, 1.0)[:, None]
    y = record.y + 10 * rough * np.random.default_rng(0).standard_normal(record.y.shape)
    su, sy = standard_deviations([record])
    data, modal = stretches([replace(record, y=y)], su, sy, 5), predictor(system, K, su, sy)
    (level,) = _levelled(modal, data, np.eye(2))
    assert np.mean(np.log(level.weight)) == pytest.approx(0.0, abs=1e-12)
    before, after = (prediction_errors(modal, each, np.eye(2))[0] for each in (data, [level]))
    calm, loud = slice(0, 120), slice(450, 600)  # levels are local to three times 50 samples
    sizes = np.array([[np.std(e[part]) for part in (calm, loud)] for e in (before, after)])
    assert sizes[0, 1] > 5 * sizes[0, 0]
    np.testing.assert_allclose(sizes[1, 1], sizes[1, 0], rtol=0.15)


def test_missing_samples_split_a_record():
    system, K, record, _ = innovation_record()
    y = record.y.copy()
    y[200, 0] = np.nan
    gappy = Record(record.t, record.u, y, record.inputs, record.outputs, hold="zoh")
    su, sy = standard_deviations([gappy])
    assert [len(each.y) for each in stretches([gappy], su, sy, 5)] == [200, 399]
    found, gain, _ = refine_samples(system, K, [gappy], su, sy, np.zeros((2, 1), dtype=bool))
    omega = np.linspace(0.1, 2.5, 10)
    # The noise is a tenth of the innovations of the inputs; 600 samples: about 1 %.
    np.testing.assert_allclose(found.response(omega), system.response(omega), atol=0.1)
    assert np.abs(np.linalg.eigvals(found.A - gain @ found.C)).max() < 1


def test_stretches_too_short_for_the_order_are_refused():
    _, _, record, _ = innovation_record()
    y = record.y.copy()
    y[::9] = np.nan
    gappy = Record(record.t, record.u, y, record.inputs, record.outputs, hold="zoh")
    for how in ("prediction", "linear", "simulation"):
        with pytest.raises(ValueError, match=r"no 10 samples in a row.*an order of 8"):
            sampled(gappy, 8, how, True, past=4)


@pytest.mark.second
def test_refined_samples_are_more_accurate_than_the_subspace_estimate():
    omega = np.linspace(0.1, 2.5, 10)
    errors = {True: [], False: []}
    for seed in range(8):
        system, _, record, _ = innovation_record(noise=0.3, seed=seed)
        for refine, found in errors.items():
            box = pbsid([record], order=3, transform="none", feedthrough=False, refine=refine)
            found.append(np.abs(box.system.response(omega) - system.response(omega)))
    assert np.mean(np.square(errors[True])) < np.mean(np.square(errors[False]))


def test_standard_deviations_of_a_sampled_response_are_those_of_its_logarithm():
    # The predictor c (b u + k y)/(z - μ) belongs to G = c b/(z - μ - c k), whose log has the
    # derivatives 1/(z - μ - c k) by μ, 1/b by b and c/(z - μ - c k) by k.
    mu, b, k, c, h = 0.5, 0.4, 0.3, 0.8, 0.05
    errors = np.array([0.01, 0.02, 0.03, 0.0])
    modal = Modal(*(np.array(v, dtype=complex) for v in ([mu], [[b, k]], [[c]])), np.zeros((1, 2)))
    found = SampledUncertainty(modal, np.zeros((0, 2), dtype=int), np.diag(errors), 1, h)
    omega = np.array([0.5, 5.0, 40.0])
    r = 1 / (np.exp(1j * omega * h) - mu - c * k)
    by = np.array([errors[0] * r, np.full(3, errors[1] / b), errors[2] * c * r])
    F = found.response_factor(omega)
    size, phase = (np.linalg.norm(part, axis=-1) for part in (F.real, F.imag))
    np.testing.assert_allclose(size[:, 0, 0], np.linalg.norm(by.real, axis=0), rtol=1e-12)
    np.testing.assert_allclose(phase[:, 0, 0], np.linalg.norm(by.imag, axis=0), rtol=1e-12)
