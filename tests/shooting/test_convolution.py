"""Gauss-Newton blocks from shared signals, against those of the sensitivities themselves."""

import os
from dataclasses import fields, replace

import numpy as np
import pytest
import scipy.linalg
from truths.closed_roll import TRUTH, flown, with_holes

from casid.free import free_parameters
from casid.shooting import convolution
from casid.shooting.convolution import Convolution, Powers, summed
from casid.shooting.curvature import _moments
from casid.shooting.intervals import lay_out
from casid.shooting.sensitivity import Evaluator, Point, gathered, whiteners
from casid.shooting.unknowns import GainUnknowns
from models.six_dof import SixDof

R = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, -0.5], [0.0, -0.5, 1.0]])


def swept(model, records, interval, covariance, more=None):
    """A sweep at nodes, biases and residuals that fit nothing."""
    layout = lay_out(records, interval)
    evaluator = Evaluator(free_parameters(model), layout, more)
    rng = np.random.default_rng(4)
    point = Point(
        lam=free_parameters(model).guess[free_parameters(model).index],
        bias=rng.standard_normal((len(records), evaluator.ny)),
        nodes=rng.standard_normal((len(layout.count), evaluator.nx)),
    )
    return evaluator.sweep(point, evaluator.simulate(point), whiteners(covariance, layout))


def shared(sweep):
    """The blocks by signals, whether or not that is less work."""
    return signals(sweep).sums()


def signals(sweep):
    Ad, longest = sweep.steps.uniform()[0], sweep.layout.count.max()
    return Convolution(sweep, Powers.of(sweep.matrices.A, Ad, longest))


def check_same(found, expected, nf, nx, record, tolerance=1e-12):
    """Blocks agree, each in units of its row and column."""
    own = np.r_[0:nf, nf + nx : expected.records.shape[1]]
    total = expected.records[:, own][:, :, own]
    size = np.sqrt(np.einsum("rii->ri", total))
    unit, mine = size[:, :, None] * size[:, None], found.records[:, own][:, :, own]
    bias = slice(nf, len(own) - 1)  # the others' rows are taken of all records together
    np.testing.assert_allclose(
        mine[:, bias] / unit[:, bias], total[:, bias] / unit[:, bias], atol=tolerance
    )
    np.testing.assert_allclose(mine.transpose(0, 2, 1), mine, atol=0, rtol=1e-9)
    unit = np.sqrt(np.einsum("rii->i", total))
    unit = unit[:, None] * unit
    np.testing.assert_allclose(mine.sum(axis=0) / unit, total.sum(axis=0) / unit, atol=tolerance)
    node = np.sqrt(np.einsum("jii->ji", expected.nodes[:, :, nf : nf + nx]))
    width = np.concatenate([size[record][:, :nf], node, size[record][:, nf:]], axis=1)
    unit = node[:, :, None] * width[:, None]
    np.testing.assert_allclose(found.nodes / unit, expected.nodes / unit, atol=tolerance)
    largest = np.abs(expected.slopes).max(axis=0)
    np.testing.assert_allclose(found.slopes, expected.slopes, atol=10 * tolerance * largest.max())
    np.testing.assert_array_equal(found.ends, expected.ends)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("delay", [0.0, 0.3, 2.25])
@pytest.mark.parametrize("growing", [False, True])
def test_blocks_are_those_of_the_sensitivities(hold, delay, growing, monkeypatch):
    # Records of several intervals of unequal length, each longer than what is held at once.
    monkeypatch.setattr(convolution, "STEPS", 37)
    monkeypatch.setattr(convolution, "BYTES", 1e5)
    model = replace(TRUTH, tau=delay * 0.02)
    if growing:
        model = replace(model, Lp=1.0)
    records = [replace(flown(seed=k).between(0, 5.3 + k), hold=hold) for k in (1, 2)]
    sweep = swept(model, records, 1.7, R)
    assert len(set(sweep.layout.count)) > 1
    record = sweep.layout.record[np.argsort(sweep.layout.node)]
    check_same(shared(sweep), gathered(sweep), sweep.e.nf, sweep.e.nx, record)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_moments_are_those_of_the_sensitivities(hold, monkeypatch):
    monkeypatch.setattr(convolution, "STEPS", 37)
    monkeypatch.setattr(convolution, "BYTES", 1e5)
    records = [replace(flown(seed=k).between(0, 5.3 + k), hold=hold) for k in (1, 2)]
    sweep, rng = swept(replace(TRUTH, tau=0.025), records, 1.7, R), np.random.default_rng(3)
    weight = rng.standard_normal((sum(record.N for record in records), 6))
    last = rng.standard_normal((len(sweep.layout.count), 3))
    for mine, expected in zip(
        signals(sweep).moments(weight, last), _moments(sweep, weight, last), strict=True
    ):
        size = np.abs(expected).max(axis=0)
        np.testing.assert_allclose(mine / size, expected / size, atol=1e-11)


def rotor():
    """A lightly damped mode, a fast lag and slow modes in states that mix them all."""
    modes = scipy.linalg.block_diag([[-2.0, 30.0], [-30.0, -2.0]], [[-25.0]], np.diag([0.5, 0, 0]))
    T = np.random.default_rng(6).standard_normal((6, 6))
    return np.linalg.solve(T, modes @ T)


def test_powers_of_a_matrix_lie_in_the_space():
    for A in (
        SixDof().system().A, np.diag(np.ones(4), 1), np.zeros((3, 3)), rotor()
    ):  # fmt: skip
        Ad = scipy.linalg.expm(0.02 * A)
        powers = Powers.of(A, Ad, 120)
        for m in (0, 1, 7, 120):
            h = np.linalg.matrix_power(powers.H, m) @ powers.start
            expected = np.linalg.matrix_power(Ad, m)
            found = np.tensordot(h, powers.M, axes=1)
            np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())


def test_matrices_that_are_not_numbers_are_left_to_the_sensitivities():
    assert Powers.of(np.full((2, 2), np.nan), np.eye(2), 100) is None


def test_powers_that_rounding_spoils_are_left_to_the_sensitivities():
    A, given = rotor(), []
    Ad = scipy.linalg.expm(0.02 * A)
    for steps in (100, 400, 3200, 12800):
        powers = Powers.of(A, Ad, steps)
        given.append(powers is not None)
        for m in (1, steps // 7, steps) if given[-1] else ():
            h = np.linalg.matrix_power(powers.H, m) @ powers.start
            found, expected = np.tensordot(h, powers.M, axes=1), scipy.linalg.expm(0.02 * m * A)
            np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
    assert given[0]
    assert not given[-1]


def test_the_number_of_threads_changes_no_bit(monkeypatch):
    monkeypatch.setattr(convolution, "BYTES", 1e5)
    sweep, found = swept(TRUTH, [flown(seed=1)], 1.0, R), []
    for cores in (1, 2, 3):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, cores=cores: set(range(cores)))
        found.append(shared(sweep))
    for field in fields(found[0]):
        first, *others = (getattr(each, field.name) for each in found)
        assert all(np.array_equal(first, other) for other in others)


@pytest.mark.parametrize("case", ["holes", "filter", "two intervals", "few parameters"])
def test_what_signals_do_not_serve_is_left_to_the_sensitivities(case, monkeypatch):
    record, more = flown(seed=1).between(0, 4), None
    records = [record]
    if case == "holes":
        records = [with_holes(record)]
    elif case == "filter":
        more = GainUnknowns(np.zeros((3, 3)), free=False)
    elif case == "two intervals":
        records = [record, replace(record, t=1.5 * record.t)]
    sweep = swept(TRUTH, records, 2.0, R, more)
    monkeypatch.setattr(Convolution, "sums", lambda _: pytest.fail("signals were used"))
    monkeypatch.setattr(Convolution, "pays", case != "few parameters")
    np.testing.assert_array_equal(summed(sweep).records, gathered(sweep).records)
