"""Rounds of a linear map, whose fixed point is known."""

import numpy as np
import pytest

from casid.shooting.anderson_acceleration import Secants

GOAL = np.array([2.0, -1.0, 0.5])
F = np.diag([1.0, 4.0, 9.0])


def distances(rates, rounds):
    """How far from the goal rounds begin that leave a share of what is off, by axis."""
    secants, begin, found = Secants(), np.zeros(3), []
    for _ in range(rounds):
        found.append(float(np.linalg.norm(begin - GOAL)))
        begin = secants.ahead(begin, GOAL + np.array(rates) * (begin - GOAL), F)
    return np.array(found), secants.used


@pytest.mark.parametrize("rates", [(0.95, 0.9, 0.8), (-0.95, 0.9, -0.6), (0.98, 0.98, 0.98)])
def test_rounds_that_creep_or_swing_end_with_a_secant_an_axis(rates):
    left, used = distances(rates, 6)  # the first, and two until these are slow
    assert used
    assert left[-1] < 1e-9 * left[0]
    assert np.linalg.norm(np.array(rates) ** 5 * GOAL) > 0.5 * left[0]  # plain ones


def test_fast_rounds_are_left_alone():
    left, used = distances((0.4, 0.4, 0.4), 9)
    assert not used
    assert left == pytest.approx(left[0] * 0.4 ** np.arange(9))


def test_nothing_leads_to_where_rounds_lead_away_from():
    left, _ = distances((1.2, 1.2, 1.2), 9)
    assert (np.diff(left) > 0).all()


def test_a_round_at_a_pole_ends_where_it_ends():
    secants, nowhere = Secants(), np.full((3, 3), np.nan)
    for _ in range(3):
        assert secants.ahead(np.zeros(3), GOAL, nowhere) is GOAL


def test_rounds_past_a_kink_begin_anew():
    # Another map from there on, whose rounds do not move as those before it.
    rates, secants, begin = np.array([0.9, 0.8, 0.7]), Secants(), np.zeros(3)
    for _ in range(3):
        begin = secants.ahead(begin, GOAL + rates * (begin - GOAL), F)
    far, left = 5 - 3 * GOAL, []
    for _ in range(6):
        left.append(np.linalg.norm(begin - far))
        begin = secants.ahead(begin, far - 0.9 * rates * (begin - far), F)
    assert left[-1] < 1e-9 * left[0]


def test_two_rounds_are_mixed_for_the_least_move_by_its_information():
    rates, secants = np.array([0.9, 0.8, 0.7]), Secants()
    ends = [(1 - rates) * GOAL, (1 - rates**2) * GOAL]
    secants.ahead(np.zeros(3), ends[0], F)
    found = secants.ahead(ends[0], ends[1], F)
    moves = np.array([ends[0], ends[1] - ends[0]])
    change = moves[1] - moves[0]
    share = change @ F @ moves[1] / (change @ F @ change)
    np.testing.assert_allclose(found, ends[1] - share * (ends[1] - ends[0]))
