"""Errors of poles that nearly meet: closed forms, sums and products, coverage of a known truth."""

import numpy as np
import pytest
from scipy.signal import lfilter

from casid import Record, StateSpace
from casid.records import standard_deviations
from casid.subspace.fourier import spectra
from casid.subspace.likelihood import noise_weights, parts
from casid.subspace.modal import covariance_factor, from_modal, to_modal
from casid.subspace.pole_errors import parted, pole_errors
from casid.subspace.pooled_spectra import alike
from casid.subspace.refinement import refine
from casid.subspace.slopes import normal_equations

NONE = np.zeros((3, 2), dtype=bool)
ONE = np.ones(3)


def plant(square):
    """Poles at -5 ± √square, followed by an oscillation."""
    A = np.zeros((4, 4))
    A[:2, :2] = [[0, 1], [square - 25, -10]]
    A[2:, :2] = [[1, 0], [0, 0.2]]
    A[2:, 2:] = [[-0.3, 1.3], [-1.3, -0.3]]
    B = [[0, 0], [20, 5], [0.5, 1], [1, -0.4]]
    C = [[1, 0, 0.4, 0], [0.3, 1, 0, 0.6], [0.1, 0, 1, -0.3]]
    return StateSpace(A, B, C, np.zeros((3, 2)))


def flown(truth, seed, noise):
    """Spectra of two records of 20 s with white noise, and the scales of their channels."""
    rng, t = np.random.default_rng(seed), 0.04 * np.arange(500)
    records = []
    for name in "ab":
        u = lfilter([1.0], [1, -0.8], rng.standard_normal((500, 2)), axis=0)
        u *= ((t > 2) & (t < 14))[:, None]
        y = truth.simulate(t, u)
        y = y + noise * np.std(y, axis=0) * rng.standard_normal(y.shape)
        records.append(Record(t, u, y, ("a", "b"), ("x", "y", "z"), name))
    su, sy = standard_deviations(records)
    return spectra(records, su, sy, 20.0), su, sy


def test_errors_of_the_discriminant_do_not_depend_on_how_near_poles_are():
    errors = []
    for square in (0.5, 0.04, 0.01, 1e-3, 1e-6, -1e-8, -1e-3, -0.04):
        system = plant(square)
        lines, su, sy = flown(plant(0.0), 0, 0.02)
        modal = parted(to_modal(system, su, sy, NONE))
        known = parts(modal, alike(lines, noise_weights(to_modal(plant(0.0), su, sy, NONE), lines)))
        L = covariance_factor(normal_equations(modal, known, np.argwhere(NONE))[0], modal)
        own = np.flatnonzero(np.abs(modal.lam + 5) < 1.1)
        if len(own) == 2:  # (λ - μ)²
            gap = (modal.lam[own[0]] - modal.lam[own[1]]).real
            slope = 2 * gap * (L[own[0]] - L[own[1]])
        else:  # (2 j Im λ)²
            slope = -8 * modal.lam[own[0]].imag * L[modal.place(1)[1][own[0], 0]]
        errors.append(np.linalg.norm(slope))
    # A regular function of the model, which hardly moves: λ μ by 2 % at most.
    np.testing.assert_allclose(errors, errors[3], rtol=0.01)


@pytest.mark.parametrize("square", [4e-3, 1e-4, 1e-8, -1e-8, -1e-5])
def test_poles_are_parted_next_to_the_model(square):
    modal, omega = to_modal(plant(square), ONE[:2], ONE, NONE), np.geomspace(0.1, 30, 20)
    other = parted(modal)
    near = np.abs(modal.lam + 5) < 0.1
    assert (other.lam[~near] == modal.lam[~near]).all()
    assert np.ptp(other.lam[near].real) >= 0.149 or other.lam[near].imag[0] >= 0.0249
    G, H = (from_modal(each, ONE[:2], ONE, plant(0)).response(omega) for each in (modal, other))
    # What moves is the product of the poles, by (0.015 · 5)² of 25 at most.
    assert np.abs(H - G).max() < 3e-4 * np.abs(G).max()


def test_poles_that_are_apart_stay_as_they_are():
    modal = to_modal(plant(0.04), ONE[:2], ONE, NONE)
    assert (parted(modal).lam == modal.lam).all()
    # Alike, but no double pole: each input and output has its own.
    two = StateSpace(np.diag([-5.0, -5.001]), np.eye(2), np.eye(2), np.zeros((2, 2)))
    both = to_modal(two, ONE[:2], ONE[:2], np.zeros((2, 2), dtype=bool))
    assert (parted(both).lam == both.lam).all()


@pytest.mark.parametrize("half", [0.03, 0.03j])
def test_of_a_double_pole_errors_are_those_of_the_root_of_a_normal_number(half):
    # Poles -5 ± √D/2 of D normal about zero, deviation d: the 97.5 % quantile of √D is √(1.96 d).
    d, turn = 0.8, half / abs(half)
    lam = np.array([-5 + half, -5 - half] if turn == 1 else [-5 + half])
    step = d / (8 * half) * np.array([1.0, -1.0])[: len(lam)]
    factor = np.column_stack([step, 0 * step])
    exact = -5 + 1e-6 * (lam + 5)
    real, imag = pole_errors(exact, lam, factor)
    expected = np.sqrt(1.96 * d) / 2 / 1.96
    np.testing.assert_allclose([*real, *imag], expected, rtol=0.05)  # of 1000 draws


def test_poles_that_do_not_meet_keep_their_errors():
    lam = np.array([-1.0, -5.0, -70.0, -2 + 9j], dtype=complex)
    factor = np.diag([0.01, 0.2, 90.0, 0.1 + 0.3j])
    # The vague one is within its errors of all others, and passes them.
    real, imag = pole_errors(lam, lam, np.hstack([factor, np.ones((4, 1))]))
    np.testing.assert_array_equal(real, [0.01, 0.2, 90.0, 0.1])
    np.testing.assert_array_equal(imag, [0, 0, 0, 0.3])


def test_what_steps_have_left_counts_where_poles_nearly_meet():
    lam, step = np.array([-5.2, -4.8], dtype=complex), np.array([[0.2], [-0.2]])
    settled, left = (
        pole_errors(lam, lam, np.hstack([step, more * step]).astype(complex))[0] for more in (0, 3)
    )
    assert (left > 1.5 * settled).all()  # by √10 in the discriminant, its root in poles


@pytest.mark.second
@pytest.mark.parametrize("square", [0.4, -0.4])
def test_95_percent_intervals_of_nearly_double_poles_cover_the_truth(square):
    truth, inside = plant(square), []
    exact = -5 + np.sqrt(complex(square)) * np.array([1, -1])
    for seed in range(12):
        lines, su, sy = flown(truth, seed, 0.15)
        start = plant(square + (0.5 if seed % 2 else -0.5))  # a pair, or both real
        _, uncertainty = refine(start, lines, su, sy, NONE)
        lam, real, imag = uncertainty.pole_std()
        order = [k for k in np.argsort(np.abs(lam + 5)) if abs(lam[k] + 5) < 4.5]
        own = (
            [order[0]] * 2 if lam[order[0]].imag else sorted(order[:2], key=lambda k: -lam[k].real)
        )
        inside += list(np.abs(lam[own].real - exact.real) < 1.96 * real[own])
        inside += list(np.abs(lam[own].imag - np.abs(exact.imag)) < 1.96 * imag[own])
    # Half the starts are of the wrong kind, which stays: what is left to go is among the errors.
    assert np.mean(inside) >= 0.9
