"""Weights, grids and norms of a comparison, written out."""

import numpy as np
import pytest
from truths.structures import SECOND, TRUTH, HoverRoll, Lag

from casid.matching.comparison import Source
from casid.matching.targets import comparison_of


def test_weights_are_linear_between_their_frequencies():
    omega = np.array([1.0, 2.0, 4.0])
    weight = np.array([1.0, 3.0, 2.0])[:, None, None]
    source = comparison_of(Lag(), [SECOND], omega=omega, weight=weight).sources[0]
    at = source.weight_at(np.array([0.5, 1.0, 1.5, 3.0, 4.0, 9.0]))[:, 0, 0]
    unit = source.W[0, 0, 0]
    np.testing.assert_allclose(at / unit, [1.0, 1.0, 2.0, 2.5, 2.0, 2.0], rtol=1e-12)
    finer = source.at(np.array([1.5, 3.0]))
    np.testing.assert_allclose(finer.W[:, 0, 0] / unit, [2.0, 2.5], rtol=1e-12)
    np.testing.assert_allclose(finer.G, SECOND.response(finer.omega, source.shift), rtol=1e-12)


def test_a_single_frequency_has_one_weight():
    source = comparison_of(Lag(), [SECOND], omega=np.array([2.0])).sources[0]
    np.testing.assert_array_equal(source.weight_at(np.array([1.0, 5.0])), source.W[[0, 0]])


def test_measured_points_have_no_other_grid():
    source = Source.measured(np.ones(1), np.ones((1, 1, 1), dtype=complex), np.ones((1, 1, 1)))
    with pytest.raises(ValueError, match="measured at its own frequencies only"):
        source.at(np.array([2.0]))


def test_another_line_keeps_grid_and_weights():
    comparison = comparison_of(HoverRoll(), [TRUTH.system()], weight=np.array([[2.0], [1.0]]))
    moved = comparison.shifted(1.5)
    np.testing.assert_array_equal(moved.W, comparison.W)
    np.testing.assert_allclose(moved.s, 1.5 + 1j * comparison.s.imag)
    np.testing.assert_allclose(moved.G, TRUTH.system().response(comparison.s.imag, 1.5), rtol=1e-12)


def test_the_norm_is_the_largest_singular_value_of_the_weighted_error():
    comparison = comparison_of(HoverRoll(), [TRUTH.system()])
    model = HoverRoll().system()
    each = [
        np.linalg.svd(W * (model.response(s.imag, s.real)[0] - G), compute_uv=False)[0]
        for s, G, W in zip(comparison.s, comparison.G, comparison.W, strict=True)
    ]
    assert comparison.norm(model) == pytest.approx(max(each), rel=1e-12)
