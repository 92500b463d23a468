"""Covariances of many steps at once against a filter written out, and a Riccati solver."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from casid.shooting.riccati import MANY, Powers, Step


def some_step(nx=4, ny=3, noise=1.0, seed=0):
    """An unstable aircraft of some states in units of very different size, some of them driven."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-3, 3, nx)
    A = np.eye(nx) + 0.1 * rng.standard_normal((nx, nx))
    driven = np.diag([1.0, 0.0] * (nx // 2))
    C = rng.standard_normal((ny, nx)) / size
    Q = driven * size**2 * 1e-2
    return Step(A * size[:, None] / size, Q, C, noise * np.diag(rng.uniform(0.1, 1, ny)))


def written_out(step, P, count):
    """Channel by channel, then prediction, in Joseph's form and 64 bits of mantissa."""
    found, P = [], P.astype(np.longdouble)
    A, Q, C = (each.astype(np.longdouble) for each in (step.A, step.Q, step.C))
    for _ in range(count):
        for row, r in zip(C, np.diag(step.R), strict=True):
            gain = P @ row / (row @ P @ row + r)
            left = np.eye(len(A)) - np.outer(gain, row)
            P = left @ P @ left.T + r * np.outer(gain, gain)
        P = A @ P @ A.T + Q
        P = (P + P.T) / 2
        found.append(P.astype(float))
    return np.array(found)


def close(found, wanted, tolerance):
    size = np.sqrt(np.einsum("kii->ki", wanted))
    size[size == 0] = 1.0
    off = (found - wanted) / (size[:, :, None] * size[:, None])
    assert np.abs(off).max() < tolerance


@pytest.mark.parametrize("noise", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("start", ["nothing", "much"])
@pytest.mark.parametrize("count", [5, 21, 3 * MANY + 7])
def test_many_steps_are_those_of_a_filter_written_out(count, start, noise):
    step = some_step(noise=noise, seed=1)
    P = np.zeros((4, 4)) if start == "nothing" else 1e2 * np.diag(np.diag(step.Q) + 1e-3)
    found = np.concatenate(list(step.repeated(P, count)))
    assert found.shape == (count, 4, 4)
    close(found, written_out(step, P, count), 1e-10)


def test_in_the_end_they_are_the_solution_of_the_riccati_equation():
    step = some_step(seed=3)
    *_, last = step.repeated(np.zeros((4, 4)), 40 * MANY)
    wanted = scipy.linalg.solve_discrete_are(step.A.T, step.C.T, step.Q, step.R)
    close(last[-1:], wanted[None], 1e-8)


def test_powers_are_the_steps_taken_one_after_the_other():
    step = some_step(seed=5)
    powers = Powers.of(step, 1000)
    assert len(powers.J) == MANY
    found = powers.after(step, step.Q, MANY)
    close(found, written_out(step, step.Q, MANY), 1e-9)
    # The map over k steps without any sensor is that of the states alone.
    blind = Powers.of(replace(step, C=0 * step.C), MANY)
    k = 10
    np.testing.assert_allclose(blind.Phi[k - 1], np.linalg.matrix_power(step.A, k), rtol=1e-10)
    assert not blind.J.any()


def test_a_missing_channel_is_none():
    whole = some_step(seed=2)
    without = Step(whole.A, whole.Q, whole.C[:2], whole.R[:2, :2])
    seen = np.array([1.0, 1.0, 0.0])
    masked = replace(whole, C=whole.C * seen[:, None], R=whole.R * seen + np.diag(1 - seen))
    P = np.concatenate(list(masked.repeated(whole.Q, 2 * MANY)))
    close(P, np.concatenate(list(without.repeated(whole.Q, 2 * MANY))), 1e-9)
    K, S = masked.gain(P)
    assert not K[..., 2].any()
    assert (S[:, 2, 2] == 1).all()


def test_digits_that_a_good_sensor_costs_are_mended():
    step = some_step(noise=1e-6, seed=6)
    P = 1e2 * np.diag(np.diag(step.Q) + 1e-3)
    # Without the last step in Joseph's form 4e-10 are left.
    close(Powers.of(step, MANY).after(step, P, MANY), written_out(step, P, MANY), 1e-11)


def test_what_nothing_drives_has_no_variance_and_hinders_nothing():
    step = some_step(seed=1)
    A, Q = np.zeros((5, 5)), np.zeros((5, 5))
    A[:4, :4], A[4, 4], Q[:4, :4] = step.A, 0.9, step.Q
    more = Step(A, Q, np.column_stack([step.C, np.ones(3)]), step.R)
    found = Powers.of(more, MANY).after(more, np.zeros((5, 5)), MANY)
    close(found[:, :4, :4], written_out(step, np.zeros((4, 4)), MANY), 1e-10)
    assert not found[:, 4].any()


def test_where_too_few_digits_are_left_steps_are_taken_one_by_one():
    step = some_step(noise=1e-6)
    P = 1e2 * np.diag(np.diag(step.Q) + 1e-3)
    assert Powers.of(step, MANY).after(step, P, MANY) is None
    found = np.concatenate(list(step.repeated(P, MANY)))
    np.testing.assert_array_equal(found[0], step.ahead(P))
    np.testing.assert_array_equal(found[-1], step.ahead(found[-2]))


@pytest.mark.parametrize("noise", [1e-30, 0.0])
def test_where_sensors_are_exact_steps_are_taken_one_by_one(noise):
    step = some_step(nx=2, ny=1, noise=noise)
    powers = Powers.of(step, MANY)
    P = np.diag([1.0, 2.0])
    assert powers is None or powers.after(step, P, MANY) is None
    found = np.concatenate(list(step.repeated(P, MANY)))
    one = P
    for k in range(MANY):
        one = step.ahead(one)
        np.testing.assert_array_equal(found[k], one)


def test_gains_of_several_steps_are_those_of_each():
    steps = [some_step(seed=seed) for seed in (1, 2)]
    both = Step(*(np.stack([getattr(step, name) for step in steps]) for name in "AQCR"))
    P = np.stack([step.Q for step in steps])
    K, S = both.gain(P)
    for k, step in enumerate(steps):
        wanted = step.C @ step.Q @ step.C.T + step.R
        np.testing.assert_allclose(S[k], wanted, rtol=1e-12)
        gain = step.A @ step.Q @ step.C.T @ np.linalg.inv(wanted)
        np.testing.assert_allclose(K[k], gain, rtol=1e-8)
