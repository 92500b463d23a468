import numpy as np
import pytest
from truths.systems import campaign, unstable_plant

from casid.records import standard_deviations
from casid.subspace.fourier import spectra
from casid.subspace.likelihood import parts
from casid.subspace.modal import moved, to_modal
from casid.subspace.slopes import normal_equations


def test_normal_equations_are_those_of_the_profiled_cost():
    # Gauss-Newton is exact where the start is the truth of noise-free data; elsewhere the gradient
    # is that of the cost, the transients at their best.
    records, plant = campaign(records=2), unstable_plant()
    su, sy = standard_deviations(records)
    data = spectra(records, su, sy, 12.0)
    mask = plant.D != 0
    free, rng = np.argwhere(mask), np.random.default_rng(1)
    weights = [rng.uniform(0.5, 2.0, (len(s.omega), 3)) for s in data]
    truth = to_modal(plant, su, sy, mask)

    def cost(modal, step):
        return sum(p.cost for p in parts(moved(modal, step, free), data, weights))

    H, gradient = normal_equations(truth, data, weights, free)
    for _ in range(3):
        d = rng.standard_normal(len(H))
        twice = (cost(truth, 1e-4 * d) + cost(truth, -1e-4 * d)) / 1e-8
        assert d @ H @ d == pytest.approx(twice / 2, rel=1e-5)
    off = moved(truth, 0.05 * rng.standard_normal(len(H)), free)
    _, gradient = normal_equations(off, data, weights, free)
    h = 1e-6 * np.eye(len(H))
    expected = [(cost(off, -step) - cost(off, step)) / 4e-6 for step in h]
    np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-6 * np.abs(gradient).max())
