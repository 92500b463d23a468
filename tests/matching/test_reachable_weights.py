"""Weights by what a structure can reach, written out, and what they are for."""

from dataclasses import replace

import numpy as np
import pytest
from truths.structures import SECOND, TRUTH, HoverRoll, Lag, black_box

from casid import FrequencyResponse, Match, match
from casid.matching.reachable_weights import reachable, stated_errors
from casid.matching.targets import comparison_of

OMEGA = np.geomspace(0.3, 6.0, 12)
MISFIT = "ignore:match. measured responses are farther off than their stated errors"


def measured(system, omega=OMEGA, *, G=None, error=0.0):
    G = system.response(omega) if G is None else G
    return FrequencyResponse(
        omega=omega, G=G, coherence=np.ones(G.shape), random_error=np.full(G.shape, error),
        inputs=system.inputs, outputs=system.outputs, input_std=np.full(system.nu, 2.0),
        output_std=np.ones(system.ny),
    )  # fmt: skip


def test_pairs_are_divided_by_their_smoothed_misfit():
    target = measured(SECOND)
    model = Lag(a=1.0, k=0.5).system()
    comparison = reachable(
        comparison_of(Lag(), [target], weight="reachable"), model, [np.zeros((12, 1, 1))]
    )
    misfit = np.abs(model.response(OMEGA) - target.G)[:, 0, 0]
    coherence = 1.58 * (1 - np.exp(-1.0))
    for k, omega in enumerate(OMEGA):
        near = np.abs(np.log(OMEGA / omega)) <= 0.35
        reach = np.sqrt(np.mean(misfit[near] ** 2))
        assert reach > 0.05 * abs(target.G[k, 0, 0])  # else that would count
        assert comparison.W[k, 0, 0] == pytest.approx(coherence / reach, rel=1e-12)


def test_a_misfit_is_at_least_the_stated_error_and_a_share_of_the_response():
    exact = Lag(a=1.0, k=0.5)
    plain, vague = measured(exact.system()), measured(exact.system(), error=0.2)
    for target, share in ((plain, 0.05), (vague, 0.2 * np.sqrt(2))):
        comparison = comparison_of(Lag(), [target], weight="reachable")
        stated = [stated_errors(Lag(), target, comparison.sources[0])]
        W = reachable(comparison, exact.system(), stated).W
        size = share * np.abs(target.G) / (1.58 * (1 - np.exp(-1.0)))
        np.testing.assert_allclose(W, 1 / size, rtol=1e-12)


def test_systems_and_plain_black_boxes_state_no_error():
    for target in (TRUTH.system(), black_box(TRUTH.system())):
        source = comparison_of(HoverRoll(), [target]).sources[0]
        assert not stated_errors(HoverRoll(), target, source).any()


@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_a_truth_in_the_class_is_recovered(norm):
    fit = match(HoverRoll(), black_box(TRUTH.system()), norm=norm, weight="reachable")
    np.testing.assert_allclose(fit.model.vector(), TRUTH.vector(), rtol=1e-5)


@pytest.mark.filterwarnings(MISFIT)
def test_one_wrong_pair_does_not_rule_the_norm():
    # phi is 60 % off and p is right: by size phi decides alone, by what is reachable it does not.
    G = TRUTH.system().response(OMEGA)
    G[:, 1] *= 1 + 0.6 * np.exp(2j * OMEGA[:, None])
    target = measured(TRUTH.system(), G=G)
    right = TRUTH.system().response(OMEGA)[:, 0]
    off = {}
    for weight in ("relative", "reachable"):
        fit = match(HoverRoll(), target, norm="hinf", weight=weight)
        found = fit.model.system().response(OMEGA)[:, 0]
        off[weight] = np.linalg.norm(found - right) / np.linalg.norm(right)
    quadratic = match(HoverRoll(), target, norm="quadratic", weight="relative").model.system()
    least = np.linalg.norm(quadratic.response(OMEGA)[:, 0] - right) / np.linalg.norm(right)
    assert off["reachable"] < 1.3 * least
    assert off["reachable"] < 0.7 * off["relative"]


@pytest.mark.filterwarnings(MISFIT)
def test_weights_by_reach_are_for_all_targets():
    targets = [black_box(TRUTH.system()), measured(TRUTH.system())]
    with pytest.raises(ValueError, match="for all targets at once"):
        match(HoverRoll(), targets, weight=["reachable", None])
    off = replace(targets[1], G=targets[1].G * 1.3)
    fit = match(HoverRoll(), [targets[0], off], norm="quadratic", weight="reachable")
    assert len(fit.notes.sources) == 2


@pytest.mark.filterwarnings(MISFIT)
@pytest.mark.second
def test_a_few_biased_points_do_not_rule_a_joint_match():
    # The lowest points of an abrupt sweep: 2.5 dB and 12 degrees off at a stated error of 1.5 %.
    G = TRUTH.system().response(OMEGA)
    G[:3] *= 10 ** (2.5 / 20) * np.exp(1j * np.deg2rad(12))
    biased = measured(TRUTH.system(), G=G, error=0.015)
    right, error = TRUTH.system().response(OMEGA), {}
    for weight in ("size", "relative", "reachable"):
        fit = match(HoverRoll(), [black_box(TRUTH.system()), biased], weight=weight)
        found = fit.model.system().response(OMEGA)
        error[weight] = np.linalg.norm(found - right) / np.linalg.norm(right)
        assert fit.notes.weight == weight
    assert error["reachable"] < 0.6 * error["size"]
    assert error["reachable"] < 0.4 * error["relative"]


@pytest.mark.filterwarnings(MISFIT)
@pytest.mark.second
@pytest.mark.parametrize("priors", [None, {"Lp": (-0.5, 1e-3)}])
def test_weights_prepared_for_many_fits_are_those_of_one(priors):
    targets = [measured(TRUTH.system(), G=1.2 * TRUTH.system().response(OMEGA))]
    matching = Match(norm="quadratic", omega=OMEGA[::-1], priors=priors)
    ready = matching.prepared(HoverRoll(), targets)
    own, shared = (each.fit(HoverRoll(), targets) for each in (matching, ready))
    assert shared.cost == pytest.approx(own.cost, rel=1e-6)
    assert ready.prepared(HoverRoll(), targets) is ready
    assert shared.notes.weight == "given"
