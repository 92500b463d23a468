"""Which points count, and how much, against the definition of the cost."""

import dataclasses

import numpy as np
import pytest
from truths.structures import TRUTH, HoverRoll

from casid import FrequencyResponse
from casid.baseline.pairs import left_out, missing_channels, select, thin
from casid.matching.mismatch import weighted_errors

OMEGA = np.geomspace(0.3, 12.0, 20)


def measured(coherence=0.9):
    G = TRUTH.system().response(OMEGA)
    return FrequencyResponse(
        omega=OMEGA, G=G, coherence=np.full(G.shape, coherence), random_error=np.zeros(G.shape),
        inputs=TRUTH.inputs, outputs=TRUTH.outputs, input_std=np.ones(1), output_std=np.ones(2),
    )  # fmt: skip


def test_the_cost_of_the_comparison_is_j():
    frf = measured(0.7)
    comparison = select(HoverRoll(), frf)
    # W_γ 20/n_ω with n_ω = 20: what T&R weigh every point with.
    W = (1.58 * (1 - np.exp(-0.7))) ** 2
    np.testing.assert_allclose(comparison.decibel_weight, W, rtol=1e-12)
    off = frf.G * 10 ** (0.5 / 20)
    J = np.sum(weighted_errors(off, comparison.G, comparison.decibel_weight) ** 2)
    assert pytest.approx(2 * 20 * W * 0.25) == J  # two pairs, half a decibel


def test_its_mean_square_error_is_the_cost_to_first_order():
    comparison = select(HoverRoll(), measured())
    near = TRUTH.with_vector(TRUTH.vector() * (1 + 1e-6)).system()
    error = comparison.error(near)
    z = near.response(OMEGA) / comparison.G - 1
    J = np.sum(comparison.decibel_weight * (20 / np.log(10)) ** 2 * np.abs(z) ** 2)
    assert np.linalg.norm(error) ** 2 / len(OMEGA) == pytest.approx(J, rel=1e-12)


def test_pairs_of_few_coherent_points_are_left_out():
    frf = measured()
    frf = FrequencyResponse(**{
        name: getattr(frf, name) for name in frf.__dataclass_fields__ if name != "coherence"
    }, coherence=np.where(np.arange(20)[:, None, None] < [[4], [5]], 0.9, 0.3))  # fmt: skip
    used = select(HoverRoll(), frf).W > 0
    assert used.sum(axis=0).tolist() == [[0], [5]]


@pytest.mark.parametrize(
    ("renamed", "message"),
    [
        (
            {"inputs": ("dlat",)},
            "no pair of the model was measured: the response has no input 'lat', but dlat; rename",
        ),
        (
            {"outputs": ("P", "PHI")},
            "no pair of the model was measured: the response has no output 'p', 'phi', but P, PHI",
        ),
        # Of what both have coherence is too low.
        ({"outputs": ("p", "PHI"), "coherence": np.full((20, 2, 1), 0.3)}, "no pair has coherence"),
    ],
)
def test_names_that_differ_are_not_blamed_on_coherence(renamed, message):
    with pytest.raises(ValueError, match=message):
        select(HoverRoll(), dataclasses.replace(measured(), **renamed))


def test_missing_channels_are_named_with_what_there_is():
    assert missing_channels(HoverRoll(), measured()) == ""
    found = missing_channels(HoverRoll(), dataclasses.replace(measured(), outputs=("p", "roll")))
    assert found == (
        "the response has no output 'phi', but p, roll; rename channels, or leave them out of the "
        "model"
    )


def test_channels_in_another_order_are_found():
    frf = measured()
    swapped = FrequencyResponse(
        omega=OMEGA, G=frf.G[:, ::-1], coherence=frf.coherence[:, ::-1], inputs=frf.inputs,
        random_error=frf.random_error[:, ::-1], outputs=frf.outputs[::-1],
        input_std=frf.input_std, output_std=frf.output_std,
    )  # fmt: skip
    np.testing.assert_array_equal(select(HoverRoll(), swapped).G, select(HoverRoll(), frf).G)


def test_thinning_takes_the_nearest_measured_points():
    frf = thin(measured(), 3)
    middle = np.sqrt(OMEGA[0] * OMEGA[-1])
    nearest = OMEGA[np.argmin(np.abs(np.log(OMEGA / middle)))]
    np.testing.assert_allclose(frf.omega, [OMEGA[0], nearest, OMEGA[-1]])


def test_points_without_coherence_do_not_count_in_the_mean_either():
    whole = measured()
    gone = whole.coherence.copy()
    gone[:5, 0, 0] = np.nan
    gone[5, 0, 0] = 0.0
    pair = [(whole.outputs[0], whole.inputs[0])]
    found = select(TRUTH, dataclasses.replace(whole, coherence=gone), pair)
    rest = select(TRUTH, whole.take(np.arange(6, len(whole.omega))), pair)
    G = 1.3 * TRUTH.system().response(whole.omega)
    costs = []
    for source, response in ((found, G), (rest, G[6:])):
        r = weighted_errors(response, source.G, source.decibel_weight)
        costs.append(np.sum(r**2))
    np.testing.assert_allclose(costs[0], costs[1])
    with pytest.raises(ValueError, match="lat"):
        select(TRUTH, dataclasses.replace(whole, coherence=0 * gone), pair)


def test_measured_pairs_without_a_fitted_point_are_named():
    frf, low = measured(), np.full((20, 2, 1), 0.9)
    low[4:, 0] = 0.3
    frf = dataclasses.replace(frf, coherence=low)
    assert left_out(frf, select(HoverRoll(), frf), HoverRoll()) == [(TRUTH.outputs[0], "lat")]
    assert left_out(measured(), select(HoverRoll(), measured()), HoverRoll()) == []
