"""Starts of the innovation gain against filters by other means."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from truths.closed_roll import TRUTH, flown
from truths.systems import known_black_box

from casid import DataWarning, Model, Record, Rows, Scalar, output_error, parameter
from casid.exchange.delays import without_delay
from casid.free import free_parameters
from casid.shooting.innovation import (
    NOISE_SHARE,
    black_box_gain,
    filter_unknowns,
    kalman_gain,
    starting_noises,
    tell_of_lost_samples,
)
from casid.shooting.kalman import settling_time
from casid.shooting.starting import SURPRISE
from casid.shooting.unknowns import NoiseUnknowns


def test_the_kalman_gain_is_the_fixed_point_of_the_filters_recursion():
    record = flown(seed=1)
    system, h = TRUTH.system(), record.dt
    K = kalman_gain(TRUTH, [record])
    Q = SURPRISE**2 * system.B @ np.diag(np.mean(record.u**2, axis=0)) @ system.B.T
    Q += 1e-6 * np.trace(Q) / 3 * np.eye(3)
    R = np.diag(NOISE_SHARE**2 * np.mean(record.y**2, axis=0))
    Ad, P, C = scipy.linalg.expm(system.A * h), np.eye(3), system.C
    for _ in range(5000):
        gain = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        P = Ad @ (P - gain @ C @ P) @ Ad.T + Q * h
    # K e held over the interval does to the states what the filter's gain does.
    E = scipy.linalg.expm(np.block([[system.A, np.eye(3)], [np.zeros((3, 6))]]) * h)
    np.testing.assert_allclose(E[:3, 3:] @ K, Ad @ gain, rtol=1e-6, atol=1e-9)
    assert np.abs(np.linalg.eigvals(Ad - Ad @ gain @ C)).max() < 1


def test_the_gain_of_a_black_box_is_turned_into_the_models_states():
    system = TRUTH.system()
    K, T = np.arange(1.0, 10.0).reshape(3, 3), np.random.default_rng(2).standard_normal((3, 3))
    inverse = np.linalg.inv(T)
    turned = replace(system, A=inverse @ system.A @ T, B=inverse @ system.B, C=system.C @ T,
                     delay=np.zeros(2))  # fmt: skip
    box = replace(known_black_box(turned), K=inverse @ K)
    np.testing.assert_allclose(black_box_gain(replace(TRUTH, tau=0.0), box), K, rtol=1e-6)


@pytest.mark.filterwarnings("ignore:direct terms of delayed inputs")
def test_states_are_those_behind_the_delay():
    # The black box has the delay as four states of its own, behind those of the model.
    late = without_delay(TRUTH.system(), 4)
    K = np.zeros((late.nx, 3))
    K[:3] = np.arange(1.0, 10.0).reshape(3, 3)
    box = replace(known_black_box(late, band=(0.1, 5.0)), K=K)
    # Padé's approximation of order four errs by (ωτ)⁹ / 9! / ... below 1e-6 up to 5 rad/s.
    np.testing.assert_allclose(black_box_gain(TRUTH, box), K[:3], rtol=1e-4)


@pytest.mark.parametrize("unit", [1e-3, 1e3])  # times a second: time in kiloseconds or in ms
def test_process_noise_starts_finite_in_every_unit_of_time(unit):
    # Over two of these kiloseconds its oscillation grows by exp(200), its covariance squared.
    class Slow(Model):
        states = outputs = ("v", "p")
        inputs = ("lat",)
        growth: Scalar = parameter(default=0.1 / unit, unit="1/s")
        omega: Scalar = parameter(default=0.7 / unit, unit="1/s")

        def A(self) -> Rows:
            return [[self.growth, self.omega], [-self.omega, self.growth]]

        def B(self) -> Rows:
            return [[1], [0]]

    rng = np.random.default_rng(1)
    y, t = rng.standard_normal((500, 2)), 0.02 * unit * np.arange(500)
    record = Record(t, np.zeros((500, 1)), y, ("lat",), ("v", "p"))
    assert settling_time([record]) == pytest.approx({1e-3: 5e-3, 1e3: 100.0}[unit], rel=0.01)
    found = starting_noises(Slow(), [record], "diagonal")
    # Of noise q in both states, each output's covariance after a time h by itself is
    # q (e^{2 g h} - 1)/(2 g), of which a share of 1/2 or more is that of its own state.
    h, g = settling_time([record]), 0.1 / unit
    whole = 0.1 * np.mean(np.diff(y, 2, axis=0) ** 2) / 6 * 2 * g / np.expm1(2 * g * h)
    assert np.all((0.9 * whole < found.q0) & (found.q0 < 2.2 * whole))


def test_what_is_asked_for_decides_gain_and_freedom():
    free, records = free_parameters(TRUTH), [flown(seed=1)]
    assert filter_unknowns(free, records, False, "diagonal") is None
    gain = filter_unknowns(free, records, "gain", "diagonal")
    np.testing.assert_array_equal(gain.K, kalman_gain(TRUTH, records))
    assert gain.free
    own = filter_unknowns(free, records, np.ones((3, 3)), "diagonal")
    np.testing.assert_array_equal(own.K, 1.0)
    assert not own.free
    assert isinstance(filter_unknowns(free, records, True, "full"), NoiseUnknowns)
    sampled = replace(known_black_box(TRUTH.system()), system=replace(TRUTH.system(), dt=0.02))
    with pytest.raises(ValueError, match="this black box is discrete"):
        filter_unknowns(free, records, sampled, "diagonal")


def test_one_gain_is_told_not_to_suit_samples_lost_at_random_but_slower_sources():
    record = flown(seed=1)
    slower = np.arange(record.N)[:, None] % np.array([1, 2, 5]) > 0
    tell_of_lost_samples([record.mask(slower), record])
    lost = slower | (np.random.default_rng(1).random(record.y.shape) < [0.03, 0.2, 0.02])
    with pytest.warns(DataWarning, match=rf"samples of {record.outputs[1]} are lost at random"):
        tell_of_lost_samples([record.mask(lost)])


@pytest.mark.second
@pytest.mark.parametrize("noise", [np.zeros((3, 3)), False])
def test_a_fit_by_one_gain_tells_of_lost_samples_and_output_error_does_not(noise):
    record = flown(seed=1).between(0, 4)
    lost = record.mask(np.random.default_rng(1).random(record.y.shape) < 0.2)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        output_error(TRUTH, [lost], process_noise=noise)
    assert any("lost at random" in str(each.message) for each in told) == (noise is not False)
