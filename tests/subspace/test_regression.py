from dataclasses import replace

import numpy as np
from truths.systems import innovation_record, predictor, sampled

from casid import Record, StateSpace
from casid.records import standard_deviations
from casid.subspace.prediction import normal_equations, stretches
from casid.subspace.regression import regress_inputs

NO_DIRECT = np.zeros((2, 1), dtype=bool)


def disturbed(system, K):
    """Other inputs and gain, the same predictor dynamics and outputs."""
    other = K + 0.3
    B = system.B + np.array([[0.7], [-1.0], [0.4]])
    return replace(system, A=system.A + (other - K) @ system.C, B=B), other


def regressed(records, system, K, R=None):
    su, sy = standard_deviations(records)
    R = np.eye(2) if R is None else R
    return regress_inputs(*disturbed(system, K), records, su, sy, NO_DIRECT, R)


def test_inputs_and_gain_are_those_of_a_dense_regression_and_near_the_truth():
    system, K, record, e = innovation_record()
    found, gain = regressed([record], system, K)
    F, none = system.A - K @ system.C, np.zeros((record.N, 1))
    channels = np.hstack([record.u, record.y])
    columns = [
        StateSpace(F, np.zeros((3, 1)), system.C, NO_DIRECT, 1.0).simulate(record.t, none, x0=x)
        for x in np.eye(3)
    ]
    columns += [np.tile(row, (record.N, 1)) for row in np.eye(2)]
    columns += [
        StateSpace(F, row[:, None], system.C, NO_DIRECT, 1.0).simulate(record.t, channels[:, [j]])
        for j in range(3)
        for row in np.eye(3)
    ]
    J = np.stack([each.ravel() for each in columns], axis=1)
    expected = np.linalg.lstsq(J, record.y.ravel())[0][5:].reshape(3, 3).T
    np.testing.assert_allclose(np.hstack([found.B, gain]), expected, atol=1e-8)
    std = np.std(e) * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))[5:].reshape(3, 3).T
    assert np.abs((expected - np.hstack([system.B, K])) / std).max() < 4
    np.testing.assert_allclose(found.A - gain @ found.C, F, atol=1e-12)


def test_weighted_prediction_errors_have_no_slope_left():
    # The gradient is that of another module, in modal coordinates and by a Gram matrix.
    system, K, record, _ = innovation_record()
    su, sy = standard_deviations([record])
    W = np.array([[1.0, 0.0], [0.4, 2.0]])
    R = np.linalg.inv(W.T @ W) * np.outer(sy, sy)
    data, free = stretches([record], su, sy, 5), np.zeros((0, 2), dtype=int)
    slopes = [
        normal_equations(predictor(each, gain, su, sy), data, W, free)[1]
        for each, gain in (disturbed(system, K), regressed([record], system, K, R))
    ]
    before, after = (slope[3:12] for slope in slopes)  # after the poles: B and K, by mode
    assert np.linalg.norm(after) < 1e-6 * np.linalg.norm(before)


def test_missing_samples_split_a_record_and_blocks_do_not_matter(monkeypatch):
    system, K, record, _ = innovation_record()
    y = record.y.copy()
    y[200, 0] = np.nan
    gappy = replace(record, y=y)
    parts = [
        Record(record.t[cut], record.u[cut], record.y[cut], ("u",), ("a", "b"), name, "zoh")
        for name, cut in (("one", slice(0, 200)), ("two", slice(201, None)))
    ]
    su, sy = standard_deviations([record])
    ends = []
    for records, block in (([gappy], 1024), (parts, 1024), (parts, 33)):
        monkeypatch.setattr("casid.subspace.regression.BLOCK", block)
        found, gain = regress_inputs(*disturbed(system, K), records, su, sy, NO_DIRECT, np.eye(2))
        ends.append(np.hstack([found.B, gain]))
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-9)


def test_a_direct_term_is_found_where_it_is_free_and_nowhere_else():
    system, _, record, _ = innovation_record(noise=0.01)
    direct = replace(record, y=record.y + record.u * np.array([0.0, 0.5]))
    box = sampled(direct, 3, "linear", ["b"])
    np.testing.assert_allclose(box.system.D, [[0.0], [0.5]], atol=0.01)
    omega = np.linspace(0.1, 2.5, 10)
    truth = system.response(omega) + np.array([[0.0], [0.5]])
    np.testing.assert_allclose(box.system.response(omega), truth, atol=0.03)
    assert np.abs(np.linalg.eigvals(box.system.A - box.K @ box.system.C)).max() < 1
    assert box.uncertainty is None


def swept(seed):
    """A lightly damped system of six states under a sweep that hardly passes two of its modes."""
    rng, t = np.random.default_rng(seed), np.arange(400.0)
    rate = np.array([0.3, 0.5, 0.8])
    poles = np.exp(-0.02 + 1j * rate)
    A = np.zeros((6, 6))
    for i, pole in enumerate(poles):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [
            [pole.real, -pole.imag], [pole.imag, pole.real]
        ]  # fmt: skip
    system = StateSpace(
        A, np.tile([[0.1], [0.0]], (3, 1)), np.tile([1.0, 0.3], (1, 3)), [[0.0]], 1.0
    )
    u = np.sin(0.1 * t + 0.5 * 0.001 * t**2)[:, None]
    y = system.simulate(t, u)
    y = y + 0.0005 * rng.standard_normal(y.shape)
    return system, Record(t, u, y, ("u",), ("y",), hold="zoh")


def test_narrow_banded_records_are_better_simulated_by_inputs_regressed_than_by_those_of_pbsid():
    error = {"linear": [], "unrefined": []}
    t = np.arange(430.0)
    u = np.sin(0.1 * t + 0.5 * 0.001 * t**2)[:, None]  # goes on where the record ends
    for seed in range(8):
        system, record = swept(seed)
        truth = system.simulate(t, u)
        for how, found in error.items():
            box = sampled(record, 6, how, past=30)
            found.append(np.std(box.system.simulate(t, u) - truth) / np.std(truth))
    assert np.median(error["linear"]) < 0.5
    assert np.median(error["linear"]) < 0.1 * np.median(error["unrefined"])
