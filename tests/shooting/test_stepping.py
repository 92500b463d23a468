"""Maps from sample to sample against SciPy's integration of the same inputs."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
from truths.closed_roll import TRUTH, flown, jittered

from casid.free import free_parameters
from casid.intersample import delayed_input
from casid.shooting.intervals import lay_out
from casid.shooting.stepping import Steps, collect_breaks, propagated
from casid.shooting.unknowns import FilterFunction, GainUnknowns

FREE = free_parameters(TRUTH)
LAM = FREE.guess[FREE.index]


def stepped(record, matrices, gain=None):
    """States, and forcing alone, one step after every sample from given states."""
    layout = lay_out([record], 1e9)
    held = [delayed_input(record.t, record.u, matrices.tau, record.hold)]
    breaks = collect_breaks(held, [record.hold], matrices.A)
    return Steps(matrices, layout, held, breaks, gain is not None), layout


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("sampling", ["regular", "irregular"])
def test_a_step_is_the_integral_of_the_state_equation(sampling, hold):
    record = replace(flown(seed=3).between(0, 3), hold=hold)
    record = jittered(record) if sampling == "irregular" else record
    m = FilterFunction(FREE, None)(LAM)
    steps, _ = stepped(record, m)
    x = np.random.default_rng(1).standard_normal((record.N, 3))
    new = steps.state(np.arange(record.N), x, steps.forcing(), None)
    t, tau = record.t, m.tau

    def rate(s, x):
        at = [
            np.interp(s - tau[j], t, record.u[:, j])
            if hold == "foh"
            else record.u[max(np.searchsorted(t, s - tau[j], side="right") - 1, 0), j]
            for j in range(2)
        ]
        return m.A @ x + m.B @ at

    for k in range(0, record.N - 1, 17):
        edges = [t[k], *sorted(s for s in t + tau[0] if t[k] < s < t[k + 1]), t[k + 1]]
        expected = x[k]
        for a, b in itertools.pairwise(edges):
            inside = (a + 1e-12, b - 1e-12)  # steps of a zero-order hold lie on the edges
            run = scipy.integrate.solve_ivp(rate, inside, expected, rtol=1e-10, atol=1e-12)
            expected = run.y[:, -1]
        np.testing.assert_allclose(new[k], expected, atol=1e-9)


def test_derivatives_of_a_step_are_its_differences():
    record, gain = jittered(flown(seed=3).between(0, 3)), 0.3 * np.ones((3, 3))
    function = FilterFunction(FREE, GainUnknowns(gain, free=False))
    rng = np.random.default_rng(2)
    x, r, d = (rng.standard_normal((record.N, 3)) for _ in range(3))
    direction = rng.standard_normal(len(LAM)) * np.abs(LAM)

    def moved(share):
        steps, _ = stepped(record, function(LAM + share * direction), gain)
        return steps.state(np.arange(record.N), x + share * d, steps.forcing(), r)

    h = 1e-5
    steps, layout = stepped(record, function(LAM), gain)
    S = np.zeros((3, record.N, len(LAM)))
    at = np.arange(record.N)
    by_lam = steps.force(at, x, r) + steps.carry(at, S, None)
    by_x = steps.carry(at, d.T[:, :, None], None)[:, :, 0]
    found = (by_lam @ direction + by_x).T
    expected = (moved(h) - moved(-h)) / (2 * h)
    np.testing.assert_allclose(found[:-1], expected[:-1], atol=1e-7)
    p = rng.standard_normal((record.N, 3))
    back = np.einsum("ni,ni->n", steps.back(layout.step, p), d)  # the adjoint of the same map
    np.testing.assert_allclose(back, np.einsum("ni,in->n", p, by_x), rtol=1e-10)


def test_states_of_intervals_are_those_of_one_step_after_the_other():
    rng, nx = np.random.default_rng(8), 3
    count = np.array([30, 17, 16, 8, 7, 1])  # some end between products
    start = np.array([31, 0, 61, 77, 17, 24])
    A, forcing = rng.standard_normal((nx, nx)) / 2, rng.standard_normal((85, nx))
    nodes = rng.standard_normal((len(count), nx))
    states, ends = propagated(A, forcing, nodes, start, count)
    for node, end, first, n in zip(nodes, ends, start, count, strict=True):
        x = node
        for k in range(first, first + n):
            np.testing.assert_allclose(states[k], x, atol=1e-12)
            x = A @ x + forcing[k]
        np.testing.assert_allclose(end, x, atol=1e-12)
