from dataclasses import replace

import numpy as np
import pytest
from truths.systems import stepped_input, unstable_plant

from casid import Record, StateSpace
from casid.subspace.campaign import Campaign
from casid.subspace.held_inputs import discretised, refine_held, undiscretised


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_discrete_models_of_held_inputs_are_the_continuous_one_at_the_samples(hold):
    plant, rng = unstable_plant(), np.random.default_rng(0)
    t = 0.1 * np.arange(80)
    u = rng.standard_normal((80, 2))
    u[0] = 0.0  # the discrete state is x - B1 u, at rest only then
    found = discretised(plant, 0.1, hold).simulate(t, u)
    np.testing.assert_allclose(found, plant.simulate(t, u, hold=hold), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_continuous_models_come_back(hold):
    plant = unstable_plant()
    back = undiscretised(discretised(plant, 0.1, hold), hold)
    for letter in "ABCD":
        wanted = getattr(plant, letter)
        np.testing.assert_allclose(getattr(back, letter), wanted, rtol=1e-8, atol=1e-10)


def test_a_discrete_pole_on_the_negative_axis_has_no_continuous_equivalent():
    one = discretised(unstable_plant(), 0.1, "zoh")
    with pytest.raises(ValueError, match="no continuous equivalent"):
        undiscretised(replace(one, A=-np.eye(5) * np.linspace(0.1, 0.5, 5)), "zoh")


@pytest.mark.second
def test_records_of_two_intervals_are_refused():
    plant, rng = unstable_plant(), np.random.default_rng(0)
    records = []
    for h in (0.02, 0.0201):
        t = h * np.arange(200)
        u = rng.standard_normal((200, plant.nu))
        y = rng.standard_normal((200, plant.ny))
        records.append(Record(t, u, y, plant.inputs, plant.outputs))
    campaign = Campaign.of(records, feedthrough=False)
    with pytest.raises(ValueError, match="equidistant records of one interval and one hold"):
        refine_held(plant, np.zeros((plant.nx, plant.ny)), campaign)


def test_direct_terms_that_stand_for_fast_dynamics_go_into_the_rest_of_the_model():
    # Below 8 rad/s a free direct term can hardly be told from what the pole at -40 does.
    A = [[-0.8, 2.0, 0.0], [-2.0, -0.8, 0.0], [0.0, 0.0, -40.0]]
    B, C = [[1.0], [0.5], [40.0]], [[1.0, 0.0, 0.3], [0.0, 1.0, -0.3]]
    truth = StateSpace(A, B, C, np.zeros((2, 1)))
    t, omega, off = 0.02 * np.arange(1500), np.geomspace(0.5, 8.0, 20), []
    for seed in range(10, 16):
        rng = np.random.default_rng(seed)
        u = stepped_input(1500, 1, rng)
        y = truth.simulate(t, u)
        y += 0.05 * np.std(y, axis=0) * rng.standard_normal(y.shape)
        campaign = Campaign.of(Record(t, u, y, ("u",), ("a", "b")), feedthrough=False)
        found, *_ = refine_held(truth, np.full((3, 2), 0.1), campaign)
        assert not found.D.any()
        off.append(np.median(np.abs(found.response(omega) / truth.response(omega) - 1)))
    assert np.mean(off) < 0.004  # 0.25 %; 0.56 % where they are dropped
