"""The optimiser: slopes, limits, and that nothing near is better."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from casid.design.criterion import Goal
from casid.design.loop import Crowd, Loop
from casid.design.optimise import Task, improved
from casid.design.shapes import Steps
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
    near = Loop(near, {}, 1e-4 * np.eye(ny), h=H, N=N)
    limits = np.concatenate([[0.1, 0.6], np.full(ny + len(MODEL.states), 0.5)])
    crowd = Crowd([near, loop], limits)
    return Task(loops=(loop,), goals=(goal,), limits=limits, others=crowd)


def steps(seed=0, **change):
    told = {"rest": 1.0, "step": 0.4, "edge": 0.15, "size": 0.1, **change}
    return Steps(T, **told, rng=np.random.default_rng(seed))


def at_start(shape):
    return shape.signal(shape.start)[:, None]


@pytest.mark.parametrize("ruling", [0, 1, 2, -1])  # sticks, rates, outputs, states
def test_slope_of_what_is_minimised_is_a_difference(task, ruling):
    limits = task.limits.copy()
    limits[ruling] *= 0.01  # the limit that counts most
    crowd = Crowd(task.loops, limits)
    task = replace(task, limits=limits, others=crowd, strain=1.2)
    r = at_start(steps())
    slope = task.slope(r, 16)[1]
    # so large because the others' shares are of single precision
    way = 1e-4 * np.sign(slope) * np.random.default_rng(1).uniform(size=r.shape)
    difference = task.slope(r + way, 16)[0] - task.slope(r - way, 16)[0]
    assert 2 * np.sum(slope * way) == pytest.approx(difference, rel=1e-4)


def test_rows_of_shares_are_what_they_answer_to_an_input(task):
    r = at_start(steps())
    places = task.extremes(r, 0.7)
    every = np.concatenate([task.shares(loop.fly(r).signals)[None] for loop in task.loops])
    every = np.concatenate([every, np.zeros((task.others.count, *every.shape[1:]))])
    every[1:, :, task.others.places] = task.others.fly(r)
    every = np.abs(every)
    assert any(model > 0 for model, *_ in places)
    assert max(every[place] for place in places) == every.max()
    found = np.abs(np.tensordot(task.rows(places), r, 2))
    np.testing.assert_allclose(found, [every[place] for place in places], atol=1e-9)


def test_the_best_found_keeps_its_limits_and_beats_random_sequences(task):
    best = improved(task, [steps()], 40)
    assert task.peaks(best).max() <= 1 + 1e-6  # the others' are of single precision
    random = [task.value(task.within(at_start(steps(seed)))) for seed in range(12)]
    assert task.value(best) < min(random) - 0.1


def test_two_levels_switch_when_brute_force_says(task):
    alone = replace(task, others=None, limits=np.append([0.1], np.full(len(task.limits) - 1, 1e3)))
    shape = steps(2, step=3.0)  # of four starts one ends in a worse optimum
    assert shape.n == 2
    found = alone.value(improved(alone, [shape], 200))
    every = []
    for moves in itertools.product(np.arange(0, 0.95, 0.2), repeat=3):
        begin, middle, end = np.array(moves) * [1, 1, -1]
        for second in (-1.0, 1.0):
            x = np.array([1.0, second, begin, middle - 0.4, end])
            if np.all(np.diff(shape.times(x)) >= 0.15):
                every.append(alone.value(shape.signal(x)[:, None]))
    assert found < min(every) + 0.01  # n samples at a limit count as n^(1/60) times it


def test_shares_of_the_others_count_for_what_nine_in_ten_judges_say(task):
    r, limits = at_start(steps()), task.limits
    frees = [free_parameters(replace(MODEL, Mq=k * MODEL.Mq)) for k in np.linspace(0.3, 2.0, 20)]
    loops = [Loop(free, {}, 1e-4 * np.eye(len(MODEL.outputs)), h=H, N=N) for free in frees]
    judged = replace(task, judges=Crowd(loops, limits))
    hardest = [np.abs(task.shares(loop.fly(r).signals)).max() for loop in loops]
    seen = task.others.peaks(r).max()
    told = judged.strained(r).strain
    assert told == pytest.approx(np.quantile(hardest, 0.9) / seen, rel=1e-5)
    assert task.strained(r).strain == 1.0
    kept = judged.within(r)
    held = [np.abs(task.shares(loop.fly(kept).signals)).max() <= 1 + 1e-5 for loop in loops]
    assert sum(held) >= 18
