from dataclasses import replace

import numpy as np
import pytest
from truths.systems import output_error_record, stepped_input

from casid import Record, StateSpace, pbsid
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.sampled import (
    STRETCHES,
    Stretches,
    _simulation_errors,
    are_candidates,
    choose_samples,
    usual_windows,
)


def resonant(N=600, noise=0.02, seed=0):
    """Two modes of 0.6 and 1.9 rad a sample, hardly damped, and a record that shows both."""
    rng = np.random.default_rng(seed)
    poles = np.array([0.99, 0.98]) * np.exp(1j * np.array([0.6, 1.9]))
    A = np.zeros((4, 4))
    for i, z in enumerate(poles):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[z.real, -z.imag], [z.imag, z.real]]
    system = StateSpace(A, [[1.0], [0.0], [0.5], [0.5]], [[0.2, 0.1, 0.3, 0.0]], [[0.0]], 1.0)
    t, u = np.arange(N, dtype=float), stepped_input(N, 1, rng, hold=1)
    y = system.simulate(t, u)
    y = y + noise * np.std(y) * rng.standard_normal(y.shape)
    return system, Record(t, u, y, ("u",), ("y",), "resonant", "zoh")


@pytest.fixture(scope="module")
def chosen():
    system, record = resonant()
    return system, record, pbsid(record)


@pytest.mark.campaign
def test_coarse_samples_of_hardly_damped_modes_are_chosen_without_a_word(chosen):
    system, record, box = chosen
    assert box.transform == "none"
    assert box.selection.criterion == "held-out stretches"
    rng = np.random.default_rng(1)
    u = rng.standard_normal((300, 1))
    t = np.arange(300.0)
    y, found = (each.simulate(t, u) for each in (system, box.system))
    projected = pbsid(record, transform="laguerre").system.simulate(t, u, hold="zoh")
    # Noise of 2 % over 600 samples, a few parameters: some tenths of a per cent.
    assert np.std(found - y) < 0.01 * np.std(y)
    assert np.std(found - y) < np.std(projected - y)


@pytest.mark.campaign
def test_the_choice_leaves_hardly_more_of_the_stretches_than_any_candidate(chosen):
    *_, box = chosen
    best = box.selection.chosen
    assert best.score <= 1.05 * min(c.score for c in box.selection.candidates)
    assert (best.order, best.refinement) == (box.order, box.refinement)
    rivals = [c for c in box.selection.candidates if c.refinement == "fourier"]
    assert best.score < min(c.score for c in rivals)
    assert all(len(c.folds) == STRETCHES for c in box.selection.candidates)
    assert "samples, " in box.selection.to_markdown()


def test_stretches_are_simulated_from_what_was_learnt_alone():
    _, record = resonant()
    judge = Stretches.of(Campaign.of(record, True))
    assert [fold.known for fold in judge.folds] == [300, 350, 400, 450, 500, 550]
    for fold in judge.folds:
        assert max(r.N for r in fold.learnt.records) == fold.known
        assert fold.known + 50 == fold.shown.N
    two = Stretches.of(Campaign.of([record, replace(record, y=2 * record.y, name="again")], True))
    assert [fold.known for fold in two.folds] == [300, 400, 500] * 2
    assert [len(fold.learnt.records) for fold in two.folds] == [2] * 6


def test_records_sampled_faster_than_their_inputs_move_are_left_to_projections():
    t, rng = np.arange(0, 40, 0.02), np.random.default_rng(0)
    lines = [np.cos(2 * np.pi * k / 40 * t + rng.uniform(0, 7)) for k in range(2, 60, 5)]
    u = np.sum(lines, axis=0)[:, None]
    plant = StateSpace([[-0.5, 2.0], [-2.0, -0.5]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.0]])
    y = plant.simulate(t, u)
    fast = Record(t, u, y + 0.05 * rng.standard_normal(y.shape), ("u",), ("y",))
    assert not are_candidates(Campaign.of(fast, True), None)
    box = pbsid(fast)
    assert (box.transform, box.refinement) == ("laguerre", "fourier")


def test_samples_are_no_candidates_where_they_cannot_be_judged():
    _, record = resonant()
    assert are_candidates(Campaign.of(record, True), None)
    growing = StateSpace([[0.1]], [[1.0]], [[1.0]], [[0.0]])
    assert not are_candidates(Campaign.of(record, True), growing)
    assert not are_candidates(Campaign.of([record, record.take(slice(None, None, 2))], True), None)
    lines = replace(record, hold="foh")
    assert are_candidates(Campaign.of(lines, True), None)
    assert not are_candidates(Campaign.of(lines, False), None)
    y = record.y.copy()
    y[7] = np.nan
    assert not are_candidates(Campaign.of(replace(record, y=y), True), None)


@pytest.mark.second
def test_slow_records_that_suit_no_laguerre_pole_are_identified_from_samples():
    record = output_error_record(N=120, noise=0.05)
    with pytest.raises(ValueError, match="suit no Laguerre pole"):
        pbsid(record.between(0, 30), transform="laguerre")
    assert pbsid(record.between(0, 59), feedthrough=False).transform == "none"


@pytest.mark.second
def test_simulations_are_no_candidates_under_feedback_of_noise():
    rng, N = np.random.default_rng(1), 600
    system, _ = resonant()
    A, x = 0.6 * system.A, np.zeros(4)
    r, u, y = rng.standard_normal((N, 1)), np.zeros((N, 1)), np.zeros((N, 1))
    for k in range(N):
        y[k] = system.C @ x + rng.standard_normal(1)
        u[k] = 0.3 * r[k] - 0.8 * y[max(k - 1, 0)]
        x = A @ x + system.B @ u[k]
    record = Record(np.arange(N, dtype=float), u, y, ("u",), ("y",), "loop", "zoh")
    box = pbsid(record, feedthrough=False, transform="none")
    assert not [c for c in box.selection.candidates if "simulation" in c.refinement]


def seen_by_five(N=200):
    """One hardly damped mode seen by five outputs, and a record that starts in motion."""
    rng = np.random.default_rng(3)
    A = 0.97 * np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    C, D = rng.standard_normal((5, 2)), np.zeros((5, 1))
    system = StateSpace(A, [[1.0], [0.3]], C, D, 1.0)
    t, u = np.arange(N, dtype=float), stepped_input(N, 1, rng, hold=1)
    y = system.simulate(t, u, x0=np.array([5.0, -3.0])) + 0.1 * rng.standard_normal((N, 5))
    return system, Record(t, u, y, system.inputs, system.outputs, "five", "zoh")


def test_a_stretch_is_simulated_from_the_best_state_and_trim_of_all_outputs_before_it():
    system, record = seen_by_five()
    fold = Stretches.of(Campaign.of(record, True)).folds[1]
    u, y, t = fold.shown.u, fold.shown.y, np.arange(fold.shown.N, dtype=float)
    free = [system.simulate(t, 0 * u, x0=x) for x in np.eye(2)]
    free += [system.simulate(t, 0 * u + 1), *(0 * y + trim for trim in np.eye(5))]
    left = y - system.simulate(t, u)
    columns, size = np.stack(free, axis=2), fold.learnt.sy  # all outputs count alike
    best = np.linalg.lstsq(
        (columns[: fold.known] / size[:, None]).reshape(-1, 8),
        (left[: fold.known] / size).ravel(),
        rcond=1e-10,
    )[0]
    expected = (left - columns @ best)[fold.known :]
    np.testing.assert_allclose(_simulation_errors(fold, system), expected, atol=1e-8)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_stretch_of_what_integrates_its_inputs_is_simulated_from_any_trim(hold):
    roll = StateSpace([[-4.0, 0], [1, 0]], [[12.0], [0]], np.eye(2), np.zeros((2, 1)))
    t, u = 0.02 * np.arange(600), np.zeros((600, 1))
    for start, size in ((50, 0.1), (80, -0.1), (100, 0.1), (400, 0.2), (420, -0.1)):
        u[start : start + 20] = size
    y = np.array([0.0, 2.0]) + roll.simulate(t, u, x0=np.array([0.3, -0.2]), hold=hold)
    record = Record(t, u + 0.47, y, ("u",), ("p", "phi"), "", hold)
    for fold in Stretches.of(Campaign.of(record, True)).folds:
        assert np.abs(_simulation_errors(fold, roll)).max() < 1e-9


def test_models_of_many_outputs_are_the_subspace_estimates():
    assert [usual_windows(n) for n in (4, 20, 34, 100)] == [(20, 10, 5), (20, 10, 5), (10, 5), (5,)]
    _, record = seen_by_five()
    rng = np.random.default_rng(4)
    y = np.hstack([record.y, record.y[:, :4]]) + 0.1 * rng.standard_normal((record.N, 9))
    many = Record(record.t, record.u, y, ("u",), tuple("abcdefghi"), "nine", "zoh")
    given = (1, 2), [Windows(5, 5, np.nan, 0.0)]
    tried, best = choose_samples(Campaign.of(many, True), *given, move=True)
    assert {c.refinement for c in tried} == {"unrefined"}
    assert best.order == 2


@pytest.mark.parametrize("how", ["unrefined", "linear"])
def test_what_a_candidate_is_worth_does_not_depend_on_units(how):
    system, record = resonant(300)
    C = [*system.C, [0.1, 0.4, 0.0, 0.2]]
    y = StateSpace(system.A, system.B, C, [[0.0], [0.0]], 1.0).simulate(record.t, record.u)
    y = y + 0.05 * np.std(y, axis=0) * np.random.default_rng(2).standard_normal(y.shape)
    shares = []
    for unit in ([1.0, 1.0], [2.0**12, 1.0], [1.0, 2.0**12]):  # of which no digit is lost
        scaled = Record(record.t, record.u, y * unit, ("u",), ("a", "b"), "", "zoh")
        judge = Stretches.of(Campaign.of(scaled, True))
        shares.append(judge.score(4, Windows(10, 10, np.nan, 0.0), how).score)
    assert shares == pytest.approx([shares[0]] * 3, rel=1e-9)
    assert shares[0] < 0.1


def test_where_predictions_leave_no_less_the_likelihood_is_taken_and_no_other_tried():
    _, record = resonant(300)
    tried, best = choose_samples(
        Campaign.of(record, True), (3, 4), [Windows(10, 10, np.nan, 0.0)], move=True
    )
    assert (best.order, best.refinement) == (4, "prediction")
    assert {c.refinement for c in tried} == {"unrefined", "linear", "prediction"}


def test_one_step_predictions_of_stretches_leave_the_noise_alone():
    _, record = resonant(noise=0.05)
    judge = Stretches.of(Campaign.of(record, True))
    candidate = judge.score(4, Windows(20, 20, np.nan, 0.0), "linear")
    # Noise of a 0.05th is a 0.0025th of the power; over 300 samples that is known to 8 %.
    assert judge.noise(candidate) == pytest.approx(0.0025, rel=0.25)
