from dataclasses import replace

import numpy as np
import pytest
from truths.systems import unstable_plant

from casid.subspace.held import discretised, undiscretised


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
