import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from truths.systems import campaign, closed_loop_record
from truths.uh60 import sweeps

from casid import DataWarning, Record, StateSpace, pbsid
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.refinement import refine
from casid.subspace.refinement_choice import _unfound
from casid.subspace.response_distance import errors_apart
from casid.subspace.trust import (
    data_doubts,
    growth,
    growth_doubts,
    missed_dynamics,
    unsteady_growth,
)

FLIGHT = Path(__file__).parents[1] / "data" / "trex550.npz"


def trex():
    """The flight's velocities, rates and attitudes."""
    found = np.load(FLIGHT)
    outputs = ("u", "v", "p", "q", "phi", "theta", "a", "b", "w", "r")
    record = Record(found["t"] - found["t"][0], found["u"], found["y"],
                    ("lat", "lon", "col", "ped"), outputs, "T-Rex 550")  # fmt: skip
    names = ("u", "v", "w", "p", "q", "r", "phi", "theta")
    return record.detrend("mean").select(outputs=names)


@pytest.mark.slow
def test_a_flight_that_does_not_support_a_model_is_said_to():
    with warnings.catch_warnings():  # of the controller, whose share is near what chance makes
        warnings.simplefilter("ignore", DataWarning)
        box = pbsid([trex()], order=10, past=10, pole=10.0, feedthrough=False)
    said, *_ = box.doubts()
    assert said.startswith("These data do not support a model")
    for name in ("u", "v", "w", "p", "r", "phi"):
        assert f"{name} " in said
    assert "vibration" in said


@pytest.mark.campaign
def test_records_made_for_identification_are_not_doubted():
    settings = {"past": 8, "pole": 8.0, "feedthrough": ["ax", "ay", "az"]}
    box = pbsid(sweeps(seed=1), order=16, **settings)
    assert box.doubts() == ()
    assert box.explained[:5].min() > 0.6  # attitudes hardly move above 5 rad/s
    # With two states less r after col is farther from what these sweeps show without noise.
    low, clean = (pbsid(sweeps(seed), order=n, **settings) for seed, n in ((1, 14), (None, 24)))
    omega = np.geomspace(0.5, 12.0, 40)
    far, near = (
        np.median(errors_apart(each.system, clean.system, each.uncertainty, omega)[:, 5, 0])
        for each in (low, box)
    )
    assert low.missed.output == "r"
    assert far > 1.5 * near


@pytest.mark.slow
def test_what_direct_terms_were_to_prediction_errors_is_no_feedback():
    settings = {"past": 8, "pole": 8.0, "feedthrough": ["ax", "ay", "az"]}
    assert pbsid(sweeps(seed=3), order=16, **settings).doubts() == ()


@pytest.mark.second
def test_noise_free_records_are_explained_fully():
    box = pbsid(campaign(), order=5, past=10, pole=6.0, feedthrough=["z"])
    np.testing.assert_allclose(box.explained, 1.0, atol=1e-6)


def test_pure_noise_is_not_explained():
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(4000)
    u, y = rng.standard_normal((4000, 2)), rng.standard_normal((4000, 2))
    box = pbsid([Record(t, u, y, ("a", "b"), ("c", "d"))], order=2, past=8, pole=6.0)
    assert box.explained.max() < 0.2
    assert [said.split(":")[0] for said in box.doubts()] == [
        "These data do not support a model", "No output responds to the inputs"
    ]  # fmt: skip


def test_most_outputs_condemn_the_data_and_a_few_do_not():
    names = ("p", "q", "r")
    assert data_doubts(np.array([0.9, 0.9, 0.3]), names) == ()
    (said,) = data_doubts(np.array([0.9, 0.3, -0.1]), names)
    assert "q 30%, r 0%" in said
    assert "p 90%" not in said


def slow_plant(rate):
    """A slow mode of that growth rate beside a fast one."""
    A = [[rate, 0.0], [0.0, -3.0]]
    return StateSpace(A, [[0.3], [3.0]], [[1.0, 1.0]], [[0.0]], None, ("u",), ("y",))


def doubted(plant, model, noise=0.05):
    rng = np.random.default_rng(3)
    options = {"duration": 20.0, "noise": noise, "gain": np.array([[2.0]])}
    records = [closed_loop_record(plant, rng, **options) for _ in range(4)]
    campaign = Campaign.of(records, False)
    data = campaign.spectra(10.0, 20.0)
    return growth(model, data, campaign.su, campaign.sy, campaign.mask)


def test_growth_that_is_there_is_not_doubted():
    assert len(doubted(slow_plant(0.4), slow_plant(0.4)).doubtful) == 0


def test_slow_growth_within_its_standard_error_is_undecided_but_that_of_an_integrator_is_none():
    # 20 s of a mode at 0 see rates of some 0.01/s; 0.002/s is e^0.04 over all of them.
    assert doubted(slow_plant(0.0), slow_plant(0.015), noise=0.3).undecided == pytest.approx(
        [0.015]
    )
    assert len(doubted(slow_plant(0.0), slow_plant(0.002), noise=0.3).modes) == 0
    assert len(doubted(slow_plant(-0.1), slow_plant(-0.1)).modes) == 0


def test_fast_growth_within_its_standard_error_is_doubted():
    found = doubted(slow_plant(0.0), slow_plant(0.11), noise=5.0)
    assert len(found.undecided) == 0
    assert found.doubtful == pytest.approx([0.11])


def test_growth_on_which_records_do_not_agree_is_doubted():
    rng = np.random.default_rng(4)
    options = {"duration": 20.0, "noise": 0.02, "gain": np.array([[2.0]])}
    rates = (0.3, -0.1, -0.1, 0.3)
    records = [closed_loop_record(slow_plant(rate), rng, **options) for rate in rates]
    campaign = Campaign.of(records, False)
    data = campaign.spectra(10.0, 20.0)
    found = growth(slow_plant(0.12), data, campaign.su, campaign.sy, campaign.mask)
    assert found.needed.all()
    assert not found.agreed.any()
    assert found.doubtful == pytest.approx([0.12])


def test_growth_at_the_limit_of_the_refinement_is_doubted_by_name():
    limit = 2 / 20.0
    (mode,) = doubted(slow_plant(0.4), slow_plant(limit)).doubtful
    assert mode.real == pytest.approx(limit)
    (said,) = growth_doubts(np.array([mode, 0.2 + 3j]))
    assert "+0.1 1/s" in said
    assert "+0.2 ± 3j 1/s" in said
    assert growth_doubts(np.zeros(0, dtype=complex)) == ()


@pytest.mark.parametrize(
    ("fewer", "doubted"),
    [
        (0.3, []),  # the same mode at half the rate at least
        (0.2, [0.5 + 3j]),  # less than half
        (-0.1, [0.5 + 3j]),
    ],
)
def test_growth_that_one_state_less_does_not_find_is_doubted(fewer, doubted):
    def pair(rate, frequency):
        A = [[rate, -frequency], [frequency, rate]]
        return StateSpace(A, [[1.0], [0.0]], [[1.0, 0.0]], [[0.0]], None, ("u",), ("y",))

    data = [SimpleNamespace(omega=np.array([2 * np.pi / 20.0]))]
    assert unsteady_growth(pair(0.5, 3.0), pair(fewer, 2.8), data) == pytest.approx(doubted)
    assert len(unsteady_growth(pair(0.5, 3.0), pair(0.5, 5.0), data)) == 1
    # A refinement may raise growth by two e-folds over the record, 0.1/s here, and to twice that.
    assert len(unsteady_growth(pair(0.5, 3.0), pair(0.2, 2.8), data, more=1.0)) == 0
    assert len(unsteady_growth(pair(0.5, 3.0), pair(0.1, 2.8), data, more=1.0)) == 1


def rotor_flight(seed):
    """A roll rate with a lightly damped mode at 5 rad/s in it: three states."""
    A = [[-2.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, -25.0, -0.4]]
    plant = StateSpace(A, [[4.0], [0.0], [2.0]], [[1.0, 0.0, 0.0]], [[0.0]], None, ("u",), ("y",))
    rng = np.random.default_rng(seed)
    options = {"duration": 30.0, "noise": 0.02, "gain": np.array([[0.2]])}
    return [closed_loop_record(plant, rng, **options, name=f"{k}") for k in range(3)]


@pytest.mark.second
@pytest.mark.parametrize("seed", [1, 2])
def test_an_order_too_low_for_a_mode_is_doubted_where_the_mode_is(seed):
    settings = {"past": 10, "pole": 8.0, "feedthrough": False}
    low = pbsid(rotor_flight(seed), order=1, **settings)
    assert low.missed.output == "y"
    assert low.missed.omega == pytest.approx(5.0, rel=0.1)
    assert any("Order 1 is too low" in each and "order=3 or more" in each for each in low.doubts())
    assert pbsid(rotor_flight(seed), order=3, **settings).doubts() == ()


@pytest.mark.campaign
def test_orders_that_are_true_are_doubted_as_seldom_as_the_level_says():
    flights = {3: rotor_flight, 5: lambda seed: campaign(noise=0.02, seed=seed)}
    settings = {3: {"pole": 8.0}, 5: {"pole": 6.0, "feedthrough": ["z"]}}
    doubted = sum(
        pbsid(fly(seed), order=n, past=10, **{"feedthrough": False} | settings[n]).missed
        is not None
        for n, fly in flights.items()
        for seed in range(200)
    )
    assert doubted <= 9  # 4 expected of 400; more than 9 once in 120 times


@pytest.mark.second
def test_an_order_too_low_is_doubted_of_prediction_errors_too():
    # What two states cannot follow looks like much noise fed back, which hands over to them.
    low = pbsid(campaign(noise=0.02), order=2, past=10, pole=6.0, feedthrough=["z"])
    assert low.refinement == "prediction"
    assert any("Order 2 is too low" in each for each in low.doubts())


def test_a_sound_unstable_campaign_raises_no_doubt():
    box = pbsid(campaign(noise=0.02), order=5, past=10, pole=6.0, feedthrough=["z"])
    assert box.system.poles().real.max() > 0
    assert box.doubts() == ()


@pytest.mark.second
@pytest.mark.parametrize(
    ("A", "gain"),
    [
        ([[-1.5, 1.0], [1.0, 0.0]], [[0.5, 1.0]]),  # poles 0.5 and -2
        ([[0.3, -2.0], [2.0, 0.3]], [[0.15, 0.5]]),  # a pair, which one state cannot have
    ],
)
def test_growth_that_one_state_less_cannot_follow_is_not_doubted(A, gain):
    plant = StateSpace(A, [[12.0], [0.0]], np.eye(2), np.zeros((2, 1)), None, ("u",), ("p", "phi"))
    rng = np.random.default_rng(1)
    options = {"duration": 30.0, "noise": 0.01, "gain": np.array(gain)}
    records = [closed_loop_record(plant, rng, **options, name=f"{k}") for k in range(4)]
    box = pbsid(records, order=2, past=8, pole=8.0, feedthrough=False)
    growth = np.linalg.eigvals(A).real.max()
    assert box.system.poles().real.max() == pytest.approx(growth, rel=0.02)
    assert box.doubts() == ()


@pytest.mark.parametrize(
    ("true", "rate", "unfound"),
    [(-0.01, 0.05, [0.05]), (0.4, 0.4, [])],  # decay follows the first as well
)
def test_what_follows_no_record_does_not_tell_growth_from_decay(true, rate, unfound, monkeypatch):
    still = StateSpace([[-9.0]], [[1e-3]], [[1.0]], [[0.0]], None, ("u",), ("y",))
    monkeypatch.setattr("casid.subspace.refinement_choice._at_order", lambda *_, **__: still)
    rng = np.random.default_rng(3)
    options = {"duration": 20.0, "noise": 0.3, "gain": np.array([[2.0]])}
    records = [closed_loop_record(slow_plant(true), rng, **options) for _ in range(4)]
    campaign = Campaign.of(records, False)
    data = campaign.spectra(10.0, 20.0)
    modes = _unfound(campaign, slow_plant(rate), Windows(8, 8, 10.0, 0.0), data)
    assert modes == pytest.approx(unfound)


@pytest.mark.parametrize(("lines", "missed"), [(8, False), (80, True)])
def test_less_is_left_of_few_lines_by_chance(lines, missed, monkeypatch):
    # Of 8 lines around 3 rad/s, a pole, a residue and 4 transients more leave a third by chance.
    omega = np.concatenate([np.linspace(0.5, 1.0, 100), np.linspace(2.9, 3.1, lines)])
    left = {1: np.ones((len(omega), 1)), 3: np.where(omega > 2.0, 1 / 3, 1.0)[:, None]}
    powers = lambda system, *_: (omega, left[system.nx])  # noqa: E731
    monkeypatch.setattr("casid.subspace.refinement.residual_powers", powers)
    one, three = (
        StateSpace(-np.eye(n), np.ones((n, 1)), np.ones((1, n)), [[0.0]], None, ("u",), ("y",))
        for n in (1, 3)
    )
    found = missed_dynamics(one, three, [None] * 4, np.ones(1), np.ones(1), (0.5, 10.0))
    assert (found is not None) == missed
    if found:
        assert (found.output, found.order) == ("y", 3)
        assert found.ratio == pytest.approx(3.0)


def test_slow_growth_that_the_records_do_not_tell_from_decay_is_left_out():
    rng = np.random.default_rng(3)
    records = [closed_loop_record(slow_plant(0.02), rng, noise=0.5) for _ in range(4)]
    campaign = Campaign.of(records, False)
    data = campaign.spectra(10.0, 20.0)
    scales = campaign.su, campaign.sy, campaign.mask
    start = refine(slow_plant(0.02), data, *scales)[0]
    limit = 2 / 20.0
    assert 0 < start.poles().real.max() < limit
    undecided = growth(start, data, *scales).undecided
    assert len(undecided) == 1
    left = refine(start, data, *scales, decaying=undecided)[0].poles()
    assert left.real.max() == pytest.approx(-0.1 * limit)
