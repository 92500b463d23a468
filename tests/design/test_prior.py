"""What is known before a flight, and what is drawn from it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats

from casid import DataWarning
from casid.design.prior import inside, known_before, noise_of, possible
from casid.free import free_parameters
from casid.shooting.spectrum import NoiseSpectrum
from models.short_period import ShortPeriod

FREE = free_parameters(ShortPeriod())
NONE = known_before(FREE, None)


def values(drawn):
    return np.array([each.guess for each in drawn])


def test_draws_scatter_as_they_are_told():
    some = np.flatnonzero(FREE.guess)
    moved = np.log(values(possible(FREE, NONE, 0.02, 500, 0))[:, some] / FREE.guess[some])
    # 500 draws of each parameter; none of the guesses is within 4 s of a bound
    assert np.std(moved) == pytest.approx(0.02, rel=0.03)


def test_every_parameter_has_one_draw_in_each_slice_of_its_range():
    some = np.flatnonzero(FREE.guess)
    moved = np.log(values(possible(FREE, NONE, 0.02, 40, 3))[:, some] / FREE.guess[some]) / 0.02
    slices = np.floor(40 * scipy.stats.norm.cdf(moved)).astype(int)
    np.testing.assert_array_equal(
        np.sort(slices, axis=0), np.tile(np.arange(40)[:, None], len(some))
    )
    assert np.abs(np.corrcoef(moved.T) - np.eye(len(some))).max() < 0.6


def test_a_covariance_is_drawn_from_with_its_correlations():
    n = len(FREE.index)
    root = (
        1e-3 * np.random.default_rng(1).standard_normal((2, 2)) * FREE.scale[FREE.index[:2], None]
    )
    known = np.zeros((n, n))
    known[:2, :2] = np.linalg.inv(root @ root.T)
    drawn = values(possible(FREE, known, 0.0, 1000, 0))
    np.testing.assert_array_equal(drawn[:, 2:], np.tile(FREE.guess[2:], (1000, 1)))
    wanted = root @ root.T
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    # 1000 draws know a covariance to some 4 % of its scale
    np.testing.assert_allclose(np.cov(drawn[:, :2].T) / scale, wanted / scale, atol=0.15)


def test_an_error_beyond_a_parameters_own_size_counts_as_that():
    known = np.zeros((len(FREE.index),) * 2)
    known[0, 0] = (1e3 * FREE.guess[0]) ** -2.0
    drawn = values(possible(FREE, known, 0.0, 400, 0))[:, 0]
    size = max(abs(FREE.guess[0]), FREE.scale[FREE.index][0])
    assert np.abs(drawn - FREE.guess[0]).max() < 5 * size


def test_a_fit_without_noise_is_told():
    n = len(FREE.index)
    known = SimpleNamespace(
        free_names=FREE.names, covariance=np.diag((1e-3 * FREE.scale[FREE.index]) ** 2)
    )
    np.testing.assert_allclose(np.diag(known_before(FREE, known)), 1 / np.diag(known.covariance))
    known.covariance = known.covariance * 1e-26
    with pytest.warns(DataWarning, match=r"errors of 1e-16 of its .* do not count as prior"):
        np.testing.assert_array_equal(known_before(FREE, known), np.zeros((n, n)))


def test_draws_keep_the_bounds():
    drawn = values(possible(FREE, NONE, 3.0, 50, 0))
    assert np.all(drawn >= FREE.lower[FREE.index])
    assert np.all(drawn <= FREE.upper[FREE.index])


def test_noise_is_stated_of_every_output_and_more_than_none():
    model, noise = ShortPeriod(), dict(zip(ShortPeriod.outputs, (0.1, 0.2, 0.3), strict=False))
    np.testing.assert_allclose(
        noise_of(model, None, noise), np.diag([noise[name] ** 2 for name in model.outputs])
    )
    name = model.outputs[-1]
    for wrong in (noise | {name: 0.0}, noise | {name: np.nan}, {model.outputs[0]: 0.1}):
        with pytest.raises(ValueError, match=f"output '{name}' has (none|0|nan); give its"):
            noise_of(model, None, wrong)


def test_the_value_furthest_outside_its_bounds_is_named():
    assert inside(FREE) is FREE
    scale = FREE.scale[FREE.index]
    for k, other in ((1, 0), (0, 1)):
        upper = FREE.upper.copy()
        upper[FREE.index[k]] = FREE.guess[k] - 0.2 * scale[k]
        upper[FREE.index[other]] = FREE.guess[other] - 0.1 * scale[other]
        with pytest.raises(ValueError, match=f"^{FREE.names[k]} = .* is outside its bounds"):
            inside(replace(FREE, upper=upper))


def test_a_filter_s_innovations_are_no_noise_of_the_outputs():
    model, n = ShortPeriod(), len(ShortPeriod.outputs)
    notes = SimpleNamespace(K=np.zeros((2, n)))
    with pytest.raises(ValueError, match="not show what turbulence does to the outputs"):
        noise_of(model, SimpleNamespace(R=np.eye(n), notes=notes), None)


def test_the_noise_of_a_spectrum_is_its_largest_in_the_band():
    model, n = ShortPeriod(), len(ShortPeriod.outputs)
    power = np.array([[9.0], [4.0], [2.0], [0.1]]) * np.ones(n)
    spectrum = NoiseSpectrum(records=("a",), omega=np.array([0.1, 1.0, 4.0, 20.0]), power=power)
    fit = SimpleNamespace(R=0.5 * np.eye(n), notes=SimpleNamespace(K=None, spectra=(spectrum,)))
    for band, expected in (((0.5, 10.0), 4.0), ((0.05, 10.0), 9.0), ((10.0, 30.0), 0.5)):
        np.testing.assert_allclose(noise_of(model, fit, None, band), expected * np.eye(n))
