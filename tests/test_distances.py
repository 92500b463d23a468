"""Distances in units of errors: silent on the truth, by name on what a structure lacks."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.linalg
from truths.closed_roll import NOISE, TRUTH, NoSideslip, campaign, off

from casid import (
    DataWarning,
    Excitation,
    FrequencyResponse,
    Model,
    Record,
    Rows,
    Scalar,
    distances,
    match,
    parameter,
    pbsid,
)
from casid.distances import searched
from casid.missing_modes import Lacking
from casid.response_fit import BoxResponse, movable, nearest
from casid.values import decode, encode

BAND = (1.05, 8.4)


@cache
def box(seed):
    return pbsid(campaign(seed, 4), order=6, pole=8.0, past=8, future=8, feedthrough=["ay"])


@cache
def missed():
    return distances(NoSideslip(), box(1), band=BAND)


def measured(factor, system=None, error=0.02, windows=(6.0,)):
    """The black box's response times a factor, as measured with errors of 2 %; or another's."""
    system, omega = system or box(1).system, np.geomspace(*BAND, 12)
    G = factor * system.response(omega)
    ones = np.ones(G.shape)
    return FrequencyResponse(
        omega=omega, G=G, coherence=0.9 * ones, random_error=error * ones, windows=windows,
        inputs=system.inputs, outputs=system.outputs,
        input_std=ones[0, 0], output_std=ones[0, :, 0],
    )  # fmt: skip


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.second
def test_the_true_structure_is_enough_wherever_the_search_begins(seed):
    found = distances(off(), box(seed), band=BAND)
    assert found.enough
    assert found.sentences() == ()
    # What is left is as large as its errors, less the share that a black box is allowed.
    assert 0.1 < np.mean([row.structure**2 for row in found.rows]) < 1.5


def test_what_a_structure_lacks_is_named_with_its_mode():
    found = missed()
    assert not found.enough
    worst = found.faults[0]
    assert (worst.input, worst.band[0]) == ("lat", pytest.approx(1.05))
    swing = TRUTH.system().poles()
    assert abs(worst.missing.pole - swing[swing.imag > 0][0]) < 0.1
    told = found.sentences()
    assert worst.told() in told[0]
    assert f"the black box has {worst.missing}, and the structure none near" in told[0]
    assert all(str(worst.missing) not in sentence for sentence in told[1:])  # once is enough


def test_a_fit_is_judged_with_what_it_holds_fixed():
    # A wrong value held fixed is a structure that is not enough; left free, it is.
    fit = match(off(), box(1), fixed={"Llat"}, norm="quadratic", omega=np.geomspace(*BAND, 20))
    assert not distances(fit, box(1), band=BAND).enough
    assert distances(fit.model, box(1), band=BAND).enough


def test_bounds_that_keep_a_structure_away_are_told():
    bounds = {"Llat": (1.5 * TRUTH.Llat, 3 * TRUTH.Llat)}
    fit = match(off(), box(1), bounds=bounds, norm="quadratic", omega=np.geomspace(*BAND, 20))
    found = distances(fit, box(1), band=BAND)
    assert not found.enough
    assert "Llat" in found.held
    assert "may be the reason" in found.headline()


@pytest.mark.second
def test_a_black_box_that_measurements_contradict_is_no_fault_of_the_structure():
    found = distances(NoSideslip(), box(1), measured(1.3), band=BAND)
    hidden = [row for row in found.rows if not row.doubted]  # by the black box's own error
    assert {row.input for row in hidden} == {"ped"}  # which the flights excite less
    assert all(row.doubted for row in found.rows if row.far)
    assert any(row.far for row in found.rows)
    assert found.enough
    agreed = distances(NoSideslip(), box(1), measured(1.01), band=BAND)
    assert not any(row.doubted for row in agreed.rows)
    assert [row.fault for row in agreed.rows] == [row.far for row in agreed.rows]


@pytest.mark.slow
def test_a_black_box_is_as_far_from_the_truth_as_its_own_errors():
    # All of the distance is the black box's, as the truth is measured without errors to speak of.
    exact = measured(1.0, TRUTH.system(), error=1e-4)
    rows = [row for s in range(1, 9) for row in distances(off(), box(s), exact, band=BAND).rows]
    assert 0.7 < np.mean([row.measured**2 for row in rows]) < 1.4
    assert np.mean([row.doubted for row in rows]) < 0.02


@pytest.mark.second
def test_errors_that_are_alike_are_exceeded_farther():
    # Twelve numbers that are one are more often far than twelve of their own.
    levels = [
        np.mean([row.measured_level for row in distances(off(), box(1), known, band=BAND).rows])
        for known in (measured(1.0, windows=w, error=0.5) for w in ((60.0,), (6.0,), ()))
    ]
    assert levels[0] < 0.9 * levels[1]
    assert levels[1] < levels[2]


def test_rows_are_pairs_by_octaves_and_survive_being_stored():
    found = missed()
    assert len(found.bands) == 3
    assert list(found.by_pair()) == [(o, i) for o in TRUTH.outputs for i in TRUTH.inputs]
    again = decode(json.loads(json.dumps(encode(found))))
    assert repr(again.rows) == repr(found.rows)
    assert again.to_markdown() == found.to_markdown()
    assert "NoSideslip misses something" in repr(found)
    assert found._repr_html_().count("σ!") == len(found.faults)


class Swing(Model):
    """Three outputs of a lag, the first swings too."""

    states = ("x", "rate", "lagged")
    inputs = ("u",)
    outputs = ("a", "b", "c", "d")

    omega: Scalar = parameter(default=2.0, lower=0.5, upper=20.0, unit="rad/s")
    gain: Scalar = parameter(default=0.3, lower=-5.0, upper=5.0, unit="rad/s^2")
    lag: Scalar = parameter(default=-1.0, lower=-10.0, upper=0.0, unit="1/s")

    def A(self) -> Rows:
        return [[0, 1, 0], [-(self.omega**2), -0.1 * self.omega, 0], [0, 0, self.lag]]

    def B(self) -> Rows:
        return [[0], [self.gain], [1]]

    def C(self) -> Rows:
        return [[0, 1, 1], [0, 0, 1], [0, 0, 2], [0, 0, 3]]


def test_a_structure_is_not_blamed_for_a_search_that_ends_in_a_minimum_that_is_not_the_lowest():
    truth, omega = Swing(omega=6.0, gain=0.05, lag=-1.3), np.geomspace(1, 8, 25)
    G, rng = truth.system().response(omega), np.random.default_rng(3)
    z = rng.standard_normal((*G.shape, 40)) + 1j * rng.standard_normal((*G.shape, 40))
    F = 0.02 * np.abs(G)[..., None] * z / np.sqrt(80)
    target = BoxResponse(
        omega=omega, G=G + F @ rng.standard_normal(40), F=F, allowed=0.003 * np.abs(G),
        scale=np.ones((4, 1)), fed_back=G[:, 0] == 0, freedom=np.full(25, np.inf),
    )  # fmt: skip
    free, bands = movable(Swing()), [(1.0, 2.0), (2.0, 4.0), (4.0, 8.0)]
    assert nearest(free, target).model.omega < 3  # a search from there alone
    found, scores = searched(free, target, bands, 1e-3)
    assert found.model.omega == pytest.approx(6.0, rel=0.02)
    assert not any((far > limits).any() for far, limits in scores)


def test_the_shorter_the_records_the_more_a_distance_may_be():
    # The size of a black box's errors is known from the lines near a band: F, not χ².
    half = replace(box(1), segments=box(1).segments[:2])
    few, all_ = (
        np.array([row.structure_level for row in distances(TRUTH, each, band=BAND).rows])
        for each in (half, box(1))
    )
    assert (few > all_).all()


def fed_back(box, low):
    """The black box had pedals come back from the outputs above a frequency."""
    omega, inputs = np.geomspace(0.1, 100.0, 60), box.system.inputs
    ones = np.ones((len(omega), len(inputs)))
    lower = np.where((omega > low)[:, None] & (np.array(inputs) == "ped"), 0.1, 0.9)
    excitation = Excitation(
        inputs=inputs, outputs=box.system.outputs, omega=omega, lower=lower, upper=lower,
        joint=ones[:, 0], answer=np.ones(3), coherence=np.ones(3), within=ones > 0, lags=4,
    )  # fmt: skip
    return replace(box, excitation=excitation)


@pytest.mark.second
def test_what_comes_back_from_the_outputs_is_no_evidence_against_a_structure():
    # Pedals whose response is three times the aircraft's, as a controller's inverse may be.
    gain = np.array([1.0, 3.0])  # of lat, ped
    system = replace(box(1).system, B=box(1).system.B * gain, D=box(1).system.D * gain)
    wrong = replace(fed_back(box(1), 0.0), system=system)
    fit = match(off(), box(1), fixed={"Lped"}, norm="quadratic", omega=np.geomspace(*BAND, 20))
    blamed = distances(fit, replace(wrong, excitation=None), band=BAND)
    assert {row.input for row in blamed.faults} >= {"ped"}
    found = distances(fit, wrong, band=BAND)
    assert found.enough
    assert {row.input for row in found.rows if row.far} == {"ped"}
    assert all(row.fed_back == (row.input == "ped") for row in found.rows)
    assert found.left_out == "ped at 1.1-8.4 rad/s"
    assert "left out, as outputs feed it back: ped" in found.headline()
    # Half as many pairs and bands are tried, each at twice the chance.
    levels = [each.rows[0].structure_level for each in (found, distances(fit, box(1), band=BAND))]
    assert levels[0] < levels[1]
    # What is missed after the other input stands.
    lacking = distances(NoSideslip(), fed_back(box(1), 0.0), band=BAND)
    assert {row.input for row in lacking.faults} == {"lat"}


def test_only_bands_that_are_fed_back_for_the_most_part_are_left_out():
    found = distances(off(), fed_back(box(1), 4.2), band=BAND)
    low = [row.fed_back for row in found.by_pair()["p", "ped"]]
    assert low == [False, False, True]


@pytest.mark.parametrize(
    ("given", "word"), [({"band": (0.0, 2.0)}, "above 0"), ({"level": 1.0}, "chance")]
)
def test_senseless_bands_and_levels_are_refused(given, word):
    with pytest.raises(ValueError, match=word):
        distances(TRUTH, box(1), **given)


def test_frequencies_that_the_black_box_does_not_know_are_left_out():
    low, high = box(1).band
    with pytest.warns(DataWarning, match="beyond these it cannot judge"):
        found = distances(TRUTH, box(1), band=(low, 10 * high))
    assert found.bands[-1][1] == pytest.approx(high)
    with pytest.raises(ValueError, match="expected frequencies among these"):
        distances(TRUTH, box(1), band=(2 * high, 3 * high))


def test_a_black_box_that_is_no_measure_is_told():
    doubted = replace(box(1), biased=True, remarks=("Noise fed back biases it.",))
    with pytest.warns(DataWarning, match="cannot judge a structure.*Noise fed back biases it"):
        distances(TRUTH, doubted)


def staircase(seed, late, h=0.02, N=1500, dwell=9):
    """Sticks that are held from sample to sample and felt ``late`` samples later, by hand."""
    rng, A, B, C, D = np.random.default_rng(seed), *map(np.array, matrices(TRUTH))
    block = np.zeros((5, 5))
    block[:3] = np.hstack([A, B])
    step = scipy.linalg.expm(h * block)
    r = np.repeat(rng.choice([-0.1, 0.0, 0.1], size=(N // dwell + 1, 2)), dwell, axis=0)[:N]
    x, u, y = np.zeros(3), np.zeros((late + N, 2)), np.zeros((N, 3))
    for k in range(N):
        u[late + k] = r[k] - [0.01 * x[1] + 0.03 * x[2], 0.0]
        felt = np.array([u[k, 0], u[late + k, 1]])
        y[k] = C @ x + D @ felt
        x = step[:3, :3] @ x + step[:3, 3:] @ felt
    names = TRUTH.inputs, TRUTH.outputs, f"staircase {seed}"
    return Record(h * np.arange(N), u[late:], y, *names, hold="zoh").with_noise(NOISE, rng)


def matrices(model):
    return model.A(), model.B(), model.C(), model.D()


@pytest.mark.repeats(1)
@pytest.mark.parametrize("first", [0, 10])
@pytest.mark.slow
def test_whole_samples_of_delay_are_no_fault_where_a_direct_term_feels_a_staircase(first):
    # Its samples are those of any delay up to one sample less, and of the black box's as well.
    flown = [staircase(first + k, late=4) for k in range(4)]
    seen = pbsid(flown, order=6, pole=10.0, past=8, feedthrough=["ay"])
    assert distances(replace(TRUTH, tau=0.08), seen).enough
    assert not distances(NoSideslip(), seen).enough


def test_a_black_box_of_samples_without_a_continuous_equivalent_measures_a_structure():
    plant, h = box(1).system, 0.02
    block = np.zeros((8, 8))
    block[:6] = np.hstack([plant.A, plant.B])
    step = scipy.linalg.expm(h * block)
    A = scipy.linalg.block_diag(step[:6, :6], -0.5)  # a mode that no continuous model has
    B, C = np.vstack([step[:6, 6:], np.full((1, 2), 1e-6)]), np.hstack([plant.C, np.ones((3, 1))])
    system = replace(plant, A=A, B=B, C=C, dt=h, states=())
    sampled = replace(box(1), system=system, K=np.zeros((7, 3)), hold="zoh", interval=h)
    with pytest.raises(ValueError, match="no continuous equivalent"):
        sampled.continuous()
    assert distances(TRUTH, sampled, band=BAND).enough
    found = distances(NoSideslip(), sampled, band=BAND)
    own, same = found.faults[0].missing, missed().faults[0].missing
    assert abs(own.pole - same.pole) < 1e-6 * abs(same.pole)
    target = BoxResponse.of(sampled, NoSideslip(), np.geomspace(*BAND, 5))
    named = Lacking.of(sampled, NoSideslip(), target).modes
    assert max(abs(mode.pole) for mode in named) < 1 / h  # that mode, at π/h and more, is none


def test_a_black_box_of_samples_is_compared_with_measurements_without_its_hold():
    plant, h = box(1).system, 0.02
    n, nu = plant.nx, plant.nu
    block = np.zeros((n + nu, n + nu))
    block[:n] = np.hstack([plant.A, plant.B])
    held = scipy.linalg.expm(h * block)  # steps of inputs that are held
    system = replace(plant, A=held[:n, :n], B=held[:n, n:], dt=h)
    sampled = replace(box(1), system=system, K=0 * box(1).K, hold="zoh", interval=h)
    found = distances(TRUTH, sampled, measured(1.0), band=BAND)
    assert not any(row.doubted for row in found.rows)
    assert max(row.measured for row in found.rows) < 0.3
