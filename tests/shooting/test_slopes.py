"""Derivatives of residuals by what every record has of its own."""

import numpy as np
import pytest
from truths.structures import Banking

from casid import Record
from casid.free import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.sensitivity import Evaluator
from casid.shooting.slopes import beginnings
from casid.shooting.starting import starting_programme

R = np.diag([0.03, 0.01]) ** 2


@pytest.mark.parametrize("biases", [True, False])
def test_initial_states_and_biases_move_residuals_as_differences_say(biases):
    rng, t, free = np.random.default_rng(1), np.arange(0, 4, 0.05), free_parameters(Banking())
    flown = [
        Record(t[:n], np.sin(t[:n, None]), rng.standard_normal((n, 2)), ["lat"], ["p", "phi"])
        for n in (80, 50)
    ]
    parts, point = starting_programme(Evaluator(free, lay_out(flown, 1.0)), free, R, biases)
    pieces = beginnings(parts, parts.pack(point))
    found = np.concatenate([np.concatenate(list(each)) for each in pieces])
    # Of one interval a record the first nodes are all there are.
    evaluator = Evaluator(free, lay_out(flown, 1e9))
    whole, point = starting_programme(evaluator, free, R, biases)
    x = whole.pack(point)

    def residuals(step, place):
        at = x.copy()
        at[place] += step
        return evaluator.simulate(whole.unpack(at)).residuals / np.sqrt(np.diag(R))

    nx, ny, first = 2, 2, whole.first_node
    for k in range(nx + ny * biases):
        own = first + k if k < nx else first - 2 * ny + k - nx
        unit = (parts.scales.state / whole.scales.state)[k] if k < nx else 1.0
        stride = nx if k < nx else ny
        both = [own, own + stride]  # of both records at once: neither moves the other's
        moved = (residuals(1e-3, both) - residuals(-1e-3, both)) / 2e-3
        np.testing.assert_allclose(found[:, :, k], moved * unit, atol=1e-6 * np.abs(moved).max())
    assert found.shape == (130, 2, nx + ny * biases)
