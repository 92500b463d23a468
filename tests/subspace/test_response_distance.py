from dataclasses import replace

import numpy as np
import pytest
from truths.systems import innovation_record, stepped_input, unstable_plant

from casid import Record, StateSpace, pbsid
from casid.subspace.campaign import Campaign
from casid.subspace.held_inputs import refine_held
from casid.subspace.response_distance import errors_apart, missed_direct
from casid.subspace.sampled import choose_samples
from casid.subspace.trust import order_doubts


class Known:
    """Independent errors of 3 % in gain and 0.02 rad in phase, of every pair."""

    def response_factor(self, omega):
        return np.tile([0.03, 0.02j], (len(omega), 3, 2, 1))


def test_distances_are_in_stated_errors_of_gain_and_phase():
    plant, omega = unstable_plant(), np.array([0.7, 3.0])
    louder = StateSpace(plant.A, plant.B * np.exp(0.06), plant.C, plant.D * np.exp(0.06))
    found = errors_apart(plant, louder, Known(), omega)
    np.testing.assert_allclose(found, 2 / np.sqrt(2))  # two errors of the gain, none of the phase


def late_flight(seed):
    """An acceleration of two states 40 ms late in noise as large as itself, and their first."""
    A, B, C = [[-1.0, -4.0], [1.0, 0.0]], [[1.0], [0.0]], [[1.0, 0.0], [-1.0, -4.0]]
    plant, t = StateSpace(A, B, C, [[0.0], [1.0]]), 0.02 * np.arange(1500)
    rng, records = np.random.default_rng(seed), []
    for name in ("first", "second"):
        u = np.repeat(rng.choice([-1.0, 1.0], size=61), 25)[:1502, None]
        y = plant.simulate(t, u[:1500])
        y += np.std(y, axis=0) * rng.standard_normal(y.shape)
        records.append(Record(t, u[2:], y, ("u",), ("p", "a"), name))
    return records


@pytest.mark.parametrize("seed", [10, 12])
def test_a_delay_that_an_order_cannot_follow_is_seen_through_strong_noise(seed):
    # No window of frequencies shows a clear share of the noise less; the phase is many errors off.
    settings = {"past": 10, "pole": 8.0, "feedthrough": ["a"]}
    low = pbsid(late_flight(seed), order=2, **settings)
    assert low.missed.errors > 5
    assert low.missed.ratio < 1.7
    assert any("changes the response by" in each for each in low.doubts())
    assert pbsid(late_flight(seed), order=4, **settings).doubts() == ()


@pytest.mark.parametrize("seed", [20, 21])
def test_direct_terms_that_stand_for_a_delay_say_that_the_order_is_too_low(seed):
    # Rate and acceleration behind a servo, the input 40 ms late, which takes more than its state.
    A, C = [[-1.0, -4.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -20.0]], [[1.0, 0, 0], [-1.0, -4.0, 1.0]]
    truth, t = StateSpace(A, [[0.0], [0.0], [20.0]], C, np.zeros((2, 1))), 0.02 * np.arange(1500)
    rng = np.random.default_rng(seed)
    u = stepped_input(1502, 1, rng)
    y = truth.simulate(t, u[:1500])
    y += 0.1 * np.std(y, axis=0) * rng.standard_normal(y.shape)

    def missed(late):
        record = Record(t, u[late : late + 1500], y, ("u",), ("p", "a"))
        campaign = Campaign.of(record, feedthrough=False)
        held, _, uncertainty, direct = refine_held(truth, np.full((3, 2), 0.1), campaign)
        return missed_direct(held, direct, uncertainty, (0.5, 8.0))

    assert missed(0) is None
    found = missed(2)
    assert found.errors > 5
    assert found.ratio is None
    (told,) = order_doubts(found, 3)
    assert "with direct terms, which are zero here" in told
    assert "order=5 or more" in told


@pytest.mark.second
@pytest.mark.parametrize(("order", "enough"), [(3, False), (5, True), (7, True)])
def test_samples_show_that_an_order_is_too_low_for_a_delay_of_whole_samples(order, enough):
    # A rate, its integral, and three samples of delay: five states, no fewer.
    roll = StateSpace([[-4.0, 0], [1, 0]], [[12.0], [0]], np.eye(2), np.zeros((2, 1)), delay=[0.06])
    rng, t, u = np.random.default_rng(2), 0.02 * np.arange(900), np.zeros((900, 1))
    for start, size in ((100, 0.08), (160, -0.08), (200, 0.08), (220, -0.08), (600, 0.06)):
        u[start : start + 20 * (1 + (size == 0.08))] = size
    y = roll.simulate(t, u, hold="zoh") + np.radians([0.3, 0.2]) * rng.standard_normal((900, 2))
    record = Record(t, u, y, ("lat",), ("p", "phi"), "", "zoh")
    box = pbsid(record, order=order, past=10, transform="none", feedthrough=False)
    assert box.measures == enough
    assert any(f"Order {order} is too low" in doubt for doubt in box.doubts()) != enough


@pytest.mark.second
def test_of_records_of_a_true_order_two_states_more_hardly_ever_say_that_it_is_too_low():
    # Wherever noise looks like a mode they find it: two of these have gains above a plain test's.
    for seed in (0, 3, 4, 5, 14):
        record = innovation_record(seed=seed)[2]
        assert pbsid([record], order=3, transform="none", feedthrough=False).missed is None
    assert pbsid([record], order=2, transform="none", feedthrough=False).missed.order == 4


@pytest.mark.second
def test_an_order_that_was_chosen_too_low_is_raised_and_one_that_was_given_is_doubted(monkeypatch):
    record = innovation_record(seed=4)[2]

    def lowest(campaign, _, windows, **settings):
        best = choose_samples(campaign, (2,), windows, **settings)[1]
        best = replace(best, refinement="prediction")
        return [best], best

    monkeypatch.setattr("casid.subspace.pbsid.choose_samples", lowest)
    box = pbsid([record], transform="none", feedthrough=False)
    assert (box.order, box.selection.chosen.order, box.missed) == (4, 4, None)
    given = pbsid([record], order=2, transform="none", feedthrough=False)
    assert (given.order, given.measures) == (2, False)
    assert any("Order 2 is too low" in doubt for doubt in given.doubts())
