"""Flight conditions whose measured responses contradict each other."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from truths.swing import Swing

from casid import DataWarning, FrequencyResponse, Trim, derivid, match
from casid.free import free_parameters
from casid.matching.condition_homogeneity import _explains, discord
from casid.matching.conditions import named
from casid.matching.targets import comparison_of

M, MLON, MQ, TAU, ERROR = 6.0, 8.0, -0.8, 0.05, 0.03
THETAS = 0.0, 0.6, 1.1
ESTIMATORS = [match, partial(match, norm="quadratic"), partial(derivid, starts=2)]
MISFIT = "ignore:match.* measured responses are farther off than their stated errors"
UNBALANCED = "ignore:Swing as estimated is far from balance"
NAMES = ["hinf", "quadratic", "derivid"]


def trim(theta, name):
    """In balance."""
    return Trim(name=name, values={"theta": theta, "lon": M * np.tan(theta) / MLON})


def response(values, theta, omega):
    """q and theta after lon about a balance, (K, 2, 1), in closed form."""
    Mq, M, Mlon, tau = values
    s = 1j * omega
    G = Mlon * np.cos(theta) * np.exp(-s * tau) / (s**2 - Mq * s + M / np.cos(theta))
    return np.stack([s * G, G], axis=1)[:, :, None]


def measured(seed, thetas=THETAS):
    """Responses with errors as stated at every balance."""
    rng, found = np.random.default_rng(seed), []
    for k, theta in enumerate(thetas):
        omega = np.geomspace(0.5, 10, 20) * (1 + 0.01 * k)
        G = response((MQ, M, MLON, TAU), theta, omega)
        G = G * (1 + ERROR * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)))
        known = {"coherence": np.ones(G.shape), "random_error": np.full(G.shape, ERROR)}
        sizes = {"input_std": np.ones(1), "output_std": np.ones(2)}
        names = {"inputs": ("lon",), "outputs": ("q", "theta")}
        found.append(FrequencyResponse(omega=omega, G=G, **known, **sizes, **names))
    return found


def flown(responses, thetas=THETAS):
    """These at conditions a, b, c."""
    named = zip(thetas, "abc", responses, strict=True)
    return {trim(theta, name): one for theta, name, one in named}


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("estimate", ESTIMATORS, ids=NAMES)
@pytest.mark.filterwarnings("error::casid.DataWarning")
def test_conditions_of_one_aircraft_contradict_nothing(estimate):
    for seed in range(4):
        estimate(Swing(), flown(measured(seed)))


@pytest.mark.second
@pytest.mark.parametrize("estimate", ESTIMATORS, ids=NAMES)
@pytest.mark.filterwarnings(UNBALANCED)
@pytest.mark.parametrize("mistake", ["values", "exchanged", "degrees"])
def test_a_response_of_another_condition_or_unit_is_told(estimate, mistake):
    responses, thetas = measured(0), THETAS
    if mistake == "values":
        thetas = 0.0, 0.6, 0.7
    elif mistake == "exchanged":
        thetas = 0.0, 1.1, 0.6
    else:
        responses[2] = replace(responses[2], G=np.degrees(1) * responses[2].G)
    with pytest.warns(DataWarning, match=r"off at conditions .*'[bc]' .* contradict each other"):
        estimate(Swing(), flown(responses, thetas))


@pytest.mark.filterwarnings(UNBALANCED)
@pytest.mark.parametrize("merged", [False, True])
def test_the_misfit_is_told_in_stated_errors(merged):
    wrong = 0.0, 0.6, 0.7
    data = flown(measured(0), wrong)
    estimate = partial(derivid, starts=2) if merged else partial(match, norm="quadratic")
    with pytest.warns(DataWarning, match="contradict each other") as told:
        fit = estimate(Swing(), data)
    said = next(str(each.message) for each in told if "contradict" in str(each.message))
    values = [getattr(fit.model, name) for name in ("Mq", "M", "Mlon", "tau")]
    sizes = re.findall(r"'(\w)' ([\d.]+)", said)
    assert sizes
    for name, size in sizes:
        # About a trim that is no balance of the estimate, the stiffness is that of its equation.
        condition, one = next(each for each in data.items() if each[0].name == name)
        theta, lon = condition.values["theta"], condition.values["lon"]
        stiff = values[1] * np.cos(theta) + values[2] * np.sin(theta) * lon
        own = values[0], stiff * np.cos(theta), *values[2:]
        off = np.abs(response(own, theta, one.omega) - one.G) / (ERROR * np.abs(one.G))
        assert float(size) == pytest.approx(np.sqrt(np.mean(off**2) / 2), rel=0.05)


@pytest.mark.filterwarnings(MISFIT)
def test_what_no_parameter_explains_is_no_contradiction():
    ripple = (1 + 0.3 * (-1.0) ** np.arange(20))[:, None, None]  # 10 stated errors
    alike = [replace(one, G=ripple * one.G) for one in measured(0)]
    match(Swing(), flown(alike), norm="quadratic")


@pytest.mark.filterwarnings("error::casid.DataWarning")
def test_what_was_not_fitted_or_states_no_error_contradicts_nothing():
    right = measured(0)
    G = right[2].G.copy()
    G[:, 0] *= np.degrees(1)
    responses = [*right[:2], replace(right[2], G=G)]
    pairs = [("theta@a", "lon@a"), ("q@b", "lon@b"), ("theta@c", "lon@c")]
    derivid(Swing(), flown(responses), pairs=pairs, starts=2)
    unknown = [replace(one, random_error=np.full(one.G.shape, np.nan)) for one in responses]
    match(Swing(), flown(unknown), norm="quadratic")


@pytest.mark.filterwarnings(MISFIT)
def test_one_condition_alone_contradicts_nothing():
    (one,) = measured(0, THETAS[:1])
    other = replace(one, G=one.G * (1 + 0.3j))
    match(Swing(), {trim(0.0, "a"): [one, other]}, norm="quadratic")


@pytest.mark.parametrize(
    ("points", "share", "explained"), [(200, 0.9, True), (200, 0.4, False), (4, 0.9, False)]
)
def test_a_step_explains_what_chance_and_the_structure_do_not(points, share, explained):
    # Two parameters; the share of the squares in their span, five stated errors off a point.
    # 0.4 is no chance either (F = 66) but not most of them, 0.9 of four points may be chance.
    rng = np.random.default_rng(1)
    J, rest = np.split(np.linalg.qr(rng.standard_normal((points, 4)))[0], 2, axis=1)
    left = 5 * np.sqrt(points) * (np.sqrt(share) * J[:, 0] + np.sqrt(1 - share) * rest[:, 0])
    assert _explains(J, left) == explained


def test_a_step_that_all_conditions_share_contradicts_nothing():
    # Responses without noise, and an estimate that is 3 % off for all of them alike.
    responses = []
    for theta, each in zip(THETAS, measured(0), strict=True):
        G = response((MQ, M, MLON, TAU), theta, each.omega)
        responses.append(replace(each, G=G, random_error=np.full(G.shape, 0.005)))
    conditions = flown(responses)
    linear = Swing().at(*conditions)
    targets = [named(each, trim_, [*conditions]) for trim_, each in conditions.items()]
    values = {"M": M, "Mlon": 1.03 * MLON, "Mq": MQ, "tau": TAU}
    at = linear.with_vector(np.array([values[name] for name in linear.parameter_names()]))
    free = free_parameters(at)
    active = np.zeros(len(free.index), dtype=bool)
    assert not discord(free, active, comparison_of(at, targets, weight="size"), targets)
