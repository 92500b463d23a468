"""One nonlinear structure from targets at several flight conditions."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from truths.swing import SmallSwing, Swing

from casid import ConvergenceError, DataWarning, FrequencyResponse, Trim, derivid, match

TRUTH = Swing(Mq=-0.8, M=6.0, Mlon=8.0, tau=0.05)
CONDITIONS = [
    Trim(name=f"{theta:g}", values={"theta": theta, "lon": 6 * np.tan(theta) / 8})
    for theta in (0.0, 0.5, 1.1)
]


def responses(omega):
    """Exact responses at every condition, as if measured at these points."""
    found = {}
    for k, trim in enumerate(CONDITIONS):
        system, own = TRUTH.at(trim).system(), omega * (1 + 0.01 * k)
        G = system.response(own)
        known = {"coherence": np.ones(G.shape), "random_error": np.full(G.shape, 0.05)}
        known |= {"leakage": np.zeros(G.shape), "multiple_coherence": np.ones(G.shape[:2])}
        known["condition"] = np.ones(len(G))
        sizes = {"input_std": np.ones(1), "output_std": np.ones(2)}
        names = {"inputs": system.inputs, "outputs": system.outputs}
        found[trim] = FrequencyResponse(omega=own, G=G, **known, **sizes, **names)
    return found


def same(fit):
    np.testing.assert_allclose(fit.model.vector(), TRUTH.vector(), rtol=1e-5)
    assert isinstance(fit.model, Swing)


@pytest.mark.second
@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_exact_targets_at_three_conditions_give_the_truth(norm):
    same(match(Swing(), {trim: TRUTH.at(trim).system() for trim in CONDITIONS}, norm=norm))


@pytest.mark.second
def test_measured_responses_at_three_conditions_give_the_truth():
    measured = responses(np.geomspace(0.5, 10, 25))
    same(match(Swing(), measured, norm="quadratic"))
    same(derivid(Swing(), measured, starts=3))


@pytest.mark.second
@pytest.mark.filterwarnings("ignore:Swing as estimated is far from balance at steep")
def test_conditions_tell_what_none_of_them_tells_alone():
    # With M sin(theta) and Mlon cos(theta) in the equations a trim about 90 deg says nothing of
    # the stick's moment; the match there leaves it where it was, both together find it.
    steep = replace(CONDITIONS[0], name="steep", values={"theta": np.pi / 2, "lon": 0.0})
    targets = {trim: TRUTH.at(trim).system() for trim in (CONDITIONS[0], steep)}
    same(match(Swing(), targets, norm="quadratic"))


@pytest.mark.filterwarnings("ignore:.* contradict each other")
@pytest.mark.parametrize("estimate", [partial(match, norm="quadratic"), partial(derivid, starts=1)])
def test_a_condition_whose_values_contradict_the_estimate_is_told(estimate):
    measured = responses(np.geomspace(0.5, 10, 25))
    wrong = replace(CONDITIONS[2], name="wrong", values={"theta": 1.1, "lon": 0.4})
    measured[wrong] = measured.pop(CONDITIONS[2])
    with pytest.warns(DataWarning, match=r"far from balance at .*wrong \(d/dt q = -"):
        estimate(Swing(), measured)


@pytest.mark.second
def test_a_start_of_what_is_unknown_contradicts_nothing():
    conditions = [replace(CONDITIONS[1], values={"theta": 0.5, "lon": 0.0}, unknown=("lon",))]
    targets = {
        own: TRUTH.at(trim).system()
        for own, trim in zip([CONDITIONS[0], *conditions], CONDITIONS[:2], strict=True)
    }
    same(match(Swing(), targets, norm="quadratic"))


@pytest.mark.parametrize(
    ("model", "data", "told"),
    [
        (SmallSwing(), {CONDITIONS[0]: TRUTH.system()}, "SmallSwing is linear"),
        (Swing(), {"60 kn": TRUTH.system()}, "{Trim"),
        (Swing(), {}, "{Trim"),
        (Swing(), {Trim(values={"thtea": 0.3}): TRUTH.system()}, "'thtea', .* mean 'theta'"),
    ],
)
def test_what_is_no_condition_is_told(model, data, told):
    with pytest.raises(ValueError, match=told):
        match(model, data)


@pytest.mark.second
def test_a_trim_that_does_not_exist_is_named_with_what_keeps_it_from_balance():
    # At theta of at most 1.2 rad a stick of 50 turns it by 8 * 50 * cos(1.2) - 6 * sin(1.2) = 139.
    trim = Trim(name="60 kn", values={"theta": 0.3, "lon": 50.0}, unknown=("theta",))
    model, bounds = replace(TRUTH, Mq=-0.5), {"theta_trim": (-1.2, 1.2)}
    with pytest.raises(ConvergenceError, match=r"'60 kn': dq/dt\" is 139.*another") as told:
        match(model, {trim: TRUTH.at(CONDITIONS[1]).system()}, fixed={"M", "Mlon"}, bounds=bounds)
    assert not told.value.best.success


@pytest.mark.parametrize("estimate", [match, derivid])
def test_one_response_for_two_conditions_is_refused_with_both(estimate):
    measured = responses(np.geomspace(0.5, 10, 25))
    rounded = replace(measured[CONDITIONS[0]], G=measured[CONDITIONS[0]].G * (1 + 1e-4))
    for copy in (measured[CONDITIONS[0]], rounded):
        with pytest.raises(ValueError, match=r"conditions '0' and '1\.1' .* give each its own"):
            estimate(Swing(), {**measured, CONDITIONS[2]: copy})


def test_one_system_for_two_conditions_is_refused():
    system = TRUTH.at(CONDITIONS[0]).system()
    with pytest.raises(ValueError, match=r"conditions '0' and '0\.5' are one object"):
        match(Swing(), dict.fromkeys(CONDITIONS[:2], system))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda one: {"G": np.full_like(one.G, np.nan)}, "NaN or zero"),
        (lambda one: {"G": 0 * one.G}, "NaN or zero"),
        (lambda one: {"coherence": np.full(one.G.shape, 0.1)}, "no pair has coherence"),
    ],
    ids=["unknown", "zero", "incoherent"],
)
def test_a_condition_of_which_nothing_counts_is_refused_by_name(change, why):
    measured = responses(np.geomspace(0.5, 10, 25))
    measured[CONDITIONS[1]] = replace(measured[CONDITIONS[1]], **change(measured[CONDITIONS[1]]))
    with pytest.raises(ValueError, match=rf"condition '0\.5': .*{why}"):
        derivid(Swing(), measured, starts=1)
    with pytest.raises(ValueError, match=r"target \(measured @0\.5\) is zero or unknown"):
        match(Swing(), measured)


@pytest.mark.second
def test_what_targets_contribute_is_told_by_condition():
    targets = {CONDITIONS[0]: TRUTH.at(CONDITIONS[0]).system()}
    targets |= dict([list(responses(np.geomspace(0.5, 10, 25)).items())[1]])
    fit = match(Swing(), targets, norm="quadratic")
    assert [row.name for row in fit.notes.sources] == ["state space @0", "measured @0.5"]
    assert fit.certificate.at_points == ("measured @0.5",)
