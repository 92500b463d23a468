"""What Gauss-Newton needs of residuals on lines, against derivatives laid out line by line."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, campaign

from casid.free import free_parameters
from casid.shooting import line_residuals
from casid.shooting.line_residuals import Residual, information
from casid.shooting.lines import transformed
from casid.shooting.noise_transients import on_lines
from casid.shooting.spectral import SpectralResiduals

LAM = 1.05 * TRUTH.vector()


@pytest.fixture(scope="module", params=["alike", "noise", "lengths", "zoh"])
def found(request):
    """Residuals of records that are alike, with noise from outside, of other lengths, in steps."""
    records = campaign(3)
    if request.param == "lengths":
        records = [each.take(slice(0, each.N - 100 * k)) for k, each in enumerate(records)]
    if request.param == "zoh":
        records = [replace(each, hold="zoh") for each in records]
    lines = transformed(records)
    rng = np.random.default_rng(0)
    weights = [np.outer(each.weight, 1 + rng.random(each.Y.shape[1])) for each in lines]
    if request.param == "alike":
        weights = [weights[0]] * len(lines)
    decay = [0.9 ** np.arange(200)[None]] * 2 + [np.zeros((0, 0))]
    outside = [on_lines(each, decay) for each in lines] if request.param == "noise" else ()
    return SpectralResiduals(free_parameters(TRUTH), lines)(LAM, weights, outside)


def laid_out(each, by=None):
    """Complex rows (K, ny, n)."""
    real, imaginary = np.split(each.moved(np.eye(len(LAM)) if by is None else by), 2, axis=1)
    return real + 1j * imaginary


def test_rows_are_differences_of_the_residuals():
    lines = transformed(campaign(3)[:2])
    weights = [np.outer(each.weight, [1.0, 2.0, 3.0]) for each in lines]
    residuals = SpectralResiduals(free_parameters(TRUTH), lines)
    at = residuals(LAM, weights)
    for a, size in enumerate(np.abs(LAM)):
        step = 1e-5 * size * np.eye(len(LAM))[a]
        moved = zip(residuals(LAM + step, weights), residuals(LAM - step, weights), strict=True)
        for each, weight, (ahead, behind) in zip(at, weights, moved, strict=True):
            own, slope = (
                laid_out(each)[..., a],
                np.sqrt(weight) * (behind.E - ahead.E) / step[a] / 2,
            )
            # What moves along the ends is theirs.
            ends = (each.ends[:, 0] + 1j * each.ends[:, 1]).reshape(slope.size, -1)
            slope -= (ends @ (ends.conj().T @ slope.ravel()).real).reshape(slope.shape)
            assert np.abs(slope - own).max() < 1e-6 * np.abs(own).max()


def test_information_and_gradient_are_those_of_the_rows(found):
    rows = [laid_out(each).reshape(-1, len(LAM)) for each in found]
    # Noise from outside is held by its variance: what is left of it adds to the sum of squares.
    for each, own in zip(found, rows, strict=True):
        basis = each.ends.reshape(-1, each.ends.shape[-1])
        spare = each.follow.T @ (np.eye(basis.shape[1]) - basis.T @ basis) @ each.follow
        np.testing.assert_allclose(
            each.F, (own.conj().T @ own).real + spare, atol=1e-11 * each.F.max()
        )
    known, F = information(found)
    np.testing.assert_allclose(F, sum(each.F for each in found), atol=1e-11 * F.max())
    assert (np.diag(known) >= np.diag(F)).all()


def test_what_is_taken_of_lines_is_a_quadratic_form_of_the_rows(found):
    C = np.linalg.inv(information(found)[1])
    for each, taken in zip(found, Residual.leverages(found, np.linalg.cholesky(C)), strict=True):
        expected = np.einsum("kia,ab,kib->ki", laid_out(each), C, laid_out(each).conj()).real
        np.testing.assert_allclose(taken, expected, atol=1e-10 * expected.max())


def test_scatter_of_correlated_residuals_is_the_rows_own(found):
    rng, across = np.random.default_rng(1), []
    for each in found:
        root = rng.standard_normal((*each.E.shape, 3)) + 1j * rng.standard_normal(
            (*each.E.shape, 3)
        )
        across.append(root @ root.conj().swapaxes(1, 2))
    if all(each.felt is found[0].felt for each in found):
        across = [across[0]] * len(found)
    expected = sum(
        np.einsum("kia,kij,kjb->ab", laid_out(each).conj(), S, laid_out(each)).real
        for each, S in zip(found, across, strict=True)
    )
    np.testing.assert_allclose(
        Residual.scatter(found, across), expected, atol=1e-11 * expected.max()
    )


def test_portions_and_shares_make_the_whole(found, monkeypatch):
    by = np.random.default_rng(2).standard_normal((len(LAM), 2))
    each = found[0]
    whole = laid_out(each, by)
    np.testing.assert_allclose(whole, laid_out(each) @ by, atol=1e-11 * np.abs(whole).max())
    monkeypatch.setattr(line_residuals, "PORTION", 7)
    np.testing.assert_allclose(laid_out(each, by), whole, rtol=1e-9)
    sizes = np.random.default_rng(3).random((len(each.E), 4, each.E.shape[1]))
    expected = sizes @ np.abs(whole) ** 2
    np.testing.assert_allclose(each.shares(by, sizes), expected, rtol=1e-9)
