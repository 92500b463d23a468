"""The optimiser: slopes, limits, and that nothing near is better."""

from dataclasses import replace

import numpy as np
import pytest

from casid.design.criterion import Goal
from casid.design.loop import Crowd, Loop
from casid.design.optimise import Task, improved
from casid.design.signals import step_family
from casid.free import free_parameters
from models.short_period import ShortPeriod

MODEL = ShortPeriod()
N, H = 160, 0.05
T = H * np.arange(N)


@pytest.fixture(scope="module")
def task():
    free = free_parameters(MODEL)
    ny, nf = len(MODEL.outputs), len(free.index)
    loop = Loop(free, {}, 1e-4 * np.eye(ny), h=H, N=N)
    goal = Goal("D", np.arange(nf), np.ones(nf), np.zeros((nf, nf)))
    near = free_parameters(replace(MODEL, **{n: 1.2 * getattr(MODEL, n) for n in free.names}))
    crowd = Crowd([Loop(near, {}, 1e-4 * np.eye(ny), h=H, N=N), loop])
    limits = np.concatenate([[0.1, 0.6], np.full(ny + len(MODEL.states), 0.5)])
    return Task(loops=(loop,), goals=(goal,), limits=limits, others=crowd)


def start(seed=0):
    family = step_family(T, 1.0, 0.4, 0.1)
    return family, np.random.default_rng(seed).choice([-0.5, 0.5], family.shape[1])


@pytest.mark.parametrize("ruling", [0, 1, 2, -1])  # sticks, rates, outputs, states
def test_slope_of_what_is_minimised_is_a_difference(task, ruling):
    limits = task.limits.copy()
    limits[ruling] *= 0.01  # the limit that counts most
    task = replace(task, limits=limits)
    family, levels = start()
    r = (family @ levels)[:, None]
    way = 1e-4 * np.random.default_rng(1).standard_normal(r.shape)
    difference = task.slope(r + way, 16)[0] - task.slope(r - way, 16)[0]
    assert 2 * np.sum(task.slope(r, 16)[1] * way) == pytest.approx(difference, rel=1e-4)


def test_the_best_found_keeps_its_limits_and_beats_random_sequences(task):
    family, levels = start()
    best, coefficients = improved(task, [family], [levels], 40)
    assert task.peaks(best).max() <= 1 + 1e-9
    random = [task.value(task.within((family @ start(seed)[1])[:, None])) for seed in range(12)]
    assert task.value(best) < min(random) - 0.1
    assert len(coefficients[0]) == family.shape[1]
