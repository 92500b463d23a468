"""Matrices, responses and their derivatives against another route to the same numbers."""

from dataclasses import replace

import casadi
import numpy as np
import pytest
from truths.swing import Swing

from casid import Constraint, Model, Rows, Scalar, Trim, parameter
from casid.evaluation import MatrixFunction
from casid.free import free_parameters


class Coupled(Model):
    """Products of parameters, a direct term, a tie and delays made of one parameter."""

    states = ("p", "r")
    inputs = ("lat", "ped")
    outputs = ("p", "r", "ay")

    Lp: Scalar = parameter(default=-2.0, lower=-9.0, upper=0.0, unit="1/s")
    Nr: Scalar = parameter(default=-1.0, lower=-9.0, upper=0.0, unit="1/s")
    k: Scalar = parameter(default=3.0, lower=0.0, upper=9.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.1, lower=0.0, upper=0.4, unit="s")

    def A(self) -> Rows:
        return [[self.Lp, 0.5], [self.Lp * self.Nr, self.Nr]]

    def B(self) -> Rows:
        return [[self.k, 0], [0, self.k**2]]

    def C(self) -> Rows:
        return [[1, 0], [0, 1], [self.Nr, 0]]

    def D(self) -> Rows:
        return [[0, 0], [0, 0], [0, self.k]]

    def delays(self):
        return {"lat": self.tau, "ped": 2 * self.tau}

    def constraints(self):
        return [Constraint("damped", self.Lp * self.Nr, lower=1.0, upper=9.0)]


S = np.array([0.3 + 0.2j, 0.3 + 2.0j, 0.1 + 7.0j])
FREE = free_parameters(Coupled(), fixed={"Nr"})


def central(f, values, step=1e-6):
    """Derivatives by central differences, one row a parameter."""
    steps = step * np.eye(len(values))
    return np.array([(f(values + h) - f(values - h)) / (2 * step) for h in steps])


def test_numbers_are_those_of_the_model():
    system, at = Coupled().system(), MatrixFunction(FREE)(FREE.guess)
    for letter, block in zip("ABCD", at.blocks, strict=True):
        np.testing.assert_array_equal(block, getattr(system, letter))
    np.testing.assert_array_equal(at.tau, [0.1, 0.2])
    np.testing.assert_array_equal(at.c, [2.0])
    for s, G in zip(S, at.response(S), strict=True):
        np.testing.assert_allclose(G, system.response(s.imag, s.real)[0], rtol=1e-13)


@pytest.mark.parametrize("part", ["N", "tau", "c"])
def test_derivatives_are_those_of_differences(part):
    matrices = MatrixFunction(FREE)
    at = matrices(FREE.guess)
    slope = {"N": at.slopes, "tau": at.dtau, "c": at.dc}[part]
    # Polynomials of second degree at most: central differences are exact but for rounding.
    expected = central(lambda x: getattr(matrices(x), part), FREE.guess)
    np.testing.assert_allclose(slope, expected, atol=1e-8)


def test_slopes_of_the_response_are_those_of_differences():
    matrices = MatrixFunction(FREE)
    G, slope = matrices(FREE.guess).response_slopes(S)
    np.testing.assert_allclose(G, matrices(FREE.guess).response(S), rtol=1e-13)
    expected = central(lambda x: matrices(x).response(S), FREE.guess)
    np.testing.assert_allclose(slope, expected, atol=1e-7)


def test_curvature_of_the_response_is_that_of_differences():
    matrices = MatrixFunction(FREE)
    at = matrices(FREE.guess)
    rng = np.random.default_rng(3)
    P = rng.standard_normal((3, 3, 2)) + 1j * rng.standard_normal((3, 3, 2))

    def gradient(x):
        return np.sum(P.conj() * matrices(x).response_slopes(S)[1], axis=(1, 2, 3)).real

    by_N, by_tau, linear = at.response_curvature(S, P)
    slope = at.slopes.reshape(len(FREE.guess), -1) @ by_N.ravel() + at.dtau @ by_tau
    np.testing.assert_allclose(slope, gradient(FREE.guess), rtol=1e-12)
    whole = linear + matrices.curvature(FREE.guess, by_N, by_tau)
    np.testing.assert_allclose(whole, central(gradient, FREE.guess), rtol=1e-6, atol=1e-6)


def test_pole_on_a_point_is_an_error():
    with pytest.raises(np.linalg.LinAlgError):
        MatrixFunction(FREE)(np.array([0.0, 3.0, 0.1])).response(np.zeros(1, dtype=complex))


@pytest.fixture(name="apart")
def three_conditions():
    """Three pendulums side by side, one of them with a delayed stick, and points to weigh."""
    conditions = [Trim(name=f"{x}", values={"theta": x, "lon": 0.2}) for x in (0.0, 0.5, 1.1)]
    free = free_parameters(Swing(tau=0.1).at(*conditions), fixed={"M"})
    at, rng = MatrixFunction(free)(free.guess), np.random.default_rng(3)
    assert [len(part.states) for part, _ in at.parts] == [2, 2, 2]
    return at, replace(at, parts=()), rng.standard_normal((3, *at.blocks[3].shape)) * (1 + 2j)


def test_parts_that_nothing_couples_are_the_whole(apart):
    at, whole, P = apart
    np.testing.assert_allclose(at.response(S), whole.response(S), atol=1e-12)
    for ours, theirs in (
        (at.response_slopes(S), whole.response_slopes(S)),
        (at.response_curvature(S, P), whole.response_curvature(S, P)),
    ):
        for one, other in zip(ours, theirs, strict=True):
            inside = np.where(at.N != 0, 1, 0) if one.shape == at.N.shape else 1
            np.testing.assert_allclose(one * inside, other * inside, atol=1e-11)
            assert np.abs(other).max() > 0.1


def test_what_is_not_seen_is_not_evaluated(apart):
    at, whole, _ = apart
    seen = np.zeros((3, *at.blocks[3].shape), dtype=bool)
    seen[0, 0, 0] = seen[2, 4:, 2] = True
    for ours, theirs in zip(at.response_slopes(S, seen), whole.response_slopes(S), strict=True):
        np.testing.assert_allclose(ours[..., seen], theirs[..., seen], atol=1e-12)
        assert not ours[..., 1, :, :].any()
        assert not ours[..., 2, :4, :].any()


class Ways(Coupled):
    """Delays that are linear in λ, and such that are not."""

    inputs = ("none", "two", "product", "square", "least")
    more: Scalar = parameter(default=0.2, lower=0.0, upper=0.4, unit="s")

    def B(self) -> Rows:
        return [[1, 0, 0, 0, 0], [0, 1, 1, 1, 1]]

    def D(self) -> Rows:
        return [[0] * 5] * 3

    def delays(self):
        two = 0.1 + 2 * self.tau + self.more
        least = casadi.fmax(self.tau, 0.05)
        product = self.tau * self.more
        return {"two": two, "product": product, "square": 3 * self.tau**2, "least": least}


def test_a_delay_is_linear_whose_slopes_are_the_same_at_every_parameter():
    found = MatrixFunction(free_parameters(Ways())).linear_delays
    assert found.tolist() == [True, True, False, False, False]
    held = MatrixFunction(free_parameters(Ways(), fixed=("more",))).linear_delays
    assert held.tolist() == [True, True, True, False, False]


def test_inputs_act_at_once_where_a_direct_term_is_written_whatever_its_value():
    assert MatrixFunction(free_parameters(Coupled(k=0.0))).direct.tolist() == [False, True]
    none = free_parameters(Coupled(k=0.0), fixed=["k"])
    assert not MatrixFunction(none).direct.any()
