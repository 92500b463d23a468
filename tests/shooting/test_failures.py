"""What output error refuses or disbelieves, in which words; and data that are no reason to."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from truths.closed_roll import (
    TRUTH,
    Roll,
    flown,
    jittered,
    noisy,
    off,
    relative_error,
    with_holes,
    with_response,
)

from casid import (
    Constraint,
    ConvergenceError,
    ModelError,
    NonlinearModel,
    Record,
    Scalar,
    SolverOptions,
    parameter,
)
from casid.free import free_parameters
from casid.shooting.output_error import output_error
from casid.shooting.search import Search
from casid.shooting.strategies import choose_interval

# ---- data ---------------------------------------------------------------------------------------


@pytest.mark.campaign
def test_holes_irregular_sampling_and_records_of_any_length_are_no_obstacle():
    def retold(record):
        """The same flight for the input between these samples, holes where they were."""
        holes = np.isnan(record.y)
        told = with_response(record, TRUTH, np.array([0.3, -0.02, 0.01]), [0.1, 0.01, -0.02])
        return replace(told, y=np.where(holes, np.nan, told.y))

    records = [
        retold(jittered(with_holes(flown(seed=1)))),
        with_holes(flown(seed=2).between(0, 5)),
        flown(seed=3).between(0, 2.3),
        retold(replace(flown(seed=4), hold="zoh")),
    ]
    fit = output_error(off(), records)
    # Sampling intervals are told apart to 1e-9 of their length; the rest is rounding.
    assert relative_error(fit).max() < 1e-5


@pytest.mark.second
def test_a_missing_channel_costs_only_its_own_information():
    records = [noisy(1), noisy(2)]
    blind = [records[0], replace(records[1], y=records[1].y * [np.nan, 1, 1])]
    whole, partial = (output_error(TRUTH, r) for r in (records, blind))
    for row in partial.parameters:
        assert row.std_error > whole[row.name].std_error
        assert abs(row.value - getattr(TRUTH, row.name)) < 4 * row.std_error


class Tied(Roll):
    """The lateral stick's side force in a fixed ratio to its roll moment."""

    def constraints(self):
        return [Constraint("Ylat = 0.2 Llat", self.Ylat - 0.2 * self.Llat)]


@pytest.mark.second
def test_ties_hold_and_sharpen_what_they_tie():
    records = [noisy(1), noisy(2)]
    free, tied = output_error(Roll(), records), output_error(Tied(), records)
    assert tied["Ylat"].value == pytest.approx(0.2 * tied["Llat"].value, rel=1e-8)
    assert tied["Ylat"].std_error == pytest.approx(0.2 * tied["Llat"].std_error, rel=1e-6)
    assert tied["Ylat"].std_error < 0.5 * free["Ylat"].std_error
    assert tied.cost > free.cost


@pytest.mark.second
def test_a_bound_is_kept_and_its_multiplier_is_its_price():
    def within(lower):
        return output_error(TRUTH, [noisy()], bounds={"Lp": (lower, 0.0)})

    fit, step = within(-2.19), 1e-3
    assert fit["Lp"].value == pytest.approx(-2.19)
    assert fit["Lp"].active
    assert np.isnan(fit["Lp"].std_error)
    slope = (within(-2.19 + step).cost - within(-2.19 - step).cost) / (2 * step)
    # Central differences of a cost whose third derivative is of the order of its second.
    assert fit["Lp"].multiplier == pytest.approx(slope, rel=1e-2)


def test_intervals_are_as_long_as_the_fastest_growing_mode_lets_them():
    records = [flown(seed=1)]
    wide = {"Lv": (-1000.0, 1000.0)}

    def chosen(Lv):
        return choose_interval(free_parameters(replace(TRUTH, Yv=-0.5, Lv=Lv), (), wide), records)

    growth = replace(TRUTH, Yv=-0.5, Lv=-3.0).system().poles()[0].real
    assert 0.2 < growth < 2.0
    assert chosen(0.0) == 5.0
    assert chosen(-3.0) == pytest.approx(1 / growth)
    assert chosen(500.0) == 0.5


# ---- refusals -----------------------------------------------------------------------------------


def test_a_start_whose_simulation_diverges_says_so_and_comes_back():
    class Wild(Roll):
        Lp: Scalar = parameter(default=1900.0, lower=-2000.0, upper=2000.0, unit="1/s")

    with pytest.raises(
        ConvergenceError, match="overflows within one interval; give a sh"
    ) as caught:
        output_error(Wild(), [noisy()])
    assert not caught.value.best.success
    assert caught.value.best["Lp"].value == 1900.0


def test_where_a_start_diverges_angles_that_are_too_large_for_radians_are_named():
    class Stiffening(NonlinearModel):
        states = ("w", "theta")
        inputs = ("de",)
        outputs = ("theta",)
        units: ClassVar[dict[str, str]] = {"de": "rad"}
        k: Scalar = parameter(default=-40.0, lower=-100.0, upper=0.0, unit="1/s^2")

        def derivatives(self, x, u):
            return [self.k * x.theta**3 - x.w**3 + u.de, x.w]

        def measurements(self, x, u):  # noqa: ARG002
            return [x.theta]

    t = 0.1 * np.arange(100)
    pair = 0.2 * np.sin(t)[:, None], 0.3 * np.cos(t)[:, None]
    for factor, said in (
        (180 / np.pi, "or convert degrees: de reaches 11.5 rad, theta reaches 17.2 rad"),
        (5.0, "or check the units of the records"),
    ):
        u, y = pair if factor == 5.0 else (factor * part for part in pair)
        k = -1e7 if factor == 5.0 else -40.0
        record = Record(t, u, y, ("de",), ("theta",), "flight")
        with pytest.raises(ConvergenceError, match=said):
            output_error(Stiffening(k=k), record, bounds={"k": (-1e8, 0.0)})


def test_a_start_that_falls_over_in_the_data_is_caught_by_the_intervals():
    start = replace(TRUTH, Lp=0.0, Lv=1.0)
    assert start.system().poles()[0].real > 1.5  # e-fold 18 times over the record
    assert relative_error(output_error(start, [flown(seed=1)])).max() < 1e-6


@pytest.mark.second
@pytest.mark.parametrize(
    ("solver", "message"),
    [
        (SolverOptions(max_iterations=2), "iteration limit reached; raise max_iterations"),
        (SolverOptions(max_seconds=1e-3), "time limit reached; raise max_seconds"),
    ],
)
def test_a_solver_limit_leaves_the_best_iterate(solver, message):
    with pytest.raises(ConvergenceError, match=message) as caught:
        output_error(off(), [noisy()], solver=solver)
    best = caught.value.best
    assert not best.success
    assert np.isfinite(best.model.vector()).all()
    assert best.R is not None


@pytest.mark.second
def test_records_too_short_are_refused():
    with pytest.raises(ValueError, match=r"'record 1' has 4 measurements; .* alone need 6"):
        output_error(TRUTH, [flown(seed=2), replace(first(2), y=first(2).y * [1, np.nan, 1])])
    with pytest.raises(ValueError, match="9 measurements for 13 unknowns"):
        output_error(TRUTH, [first(3)])
    few = SolverOptions(max_iterations=20)
    with pytest.raises(ConvergenceError, match="do not determine Lped"):
        output_error(TRUTH, [first(11)], solver=few)  # nothing has moved yet


def first(samples):
    """The beginning of a record."""
    record = noisy()
    return replace(record, t=record.t[:samples], u=record.u[:samples], y=record.y[:samples])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"interval": 0.0}, "expected seconds above 0"),
        ({"interval": np.nan}, "interval = nan, expected a number"),
        ({"R": np.eye(2)}, r"expected \(ny, ny\) = \(3, 3\)"),
        ({"R": -np.eye(3)}, "not symmetric positive definite"),
        ({"R": "banded"}, 'expected an array of numbers or "diagonal" or "full"'),
        ({"process_noise": np.eye(2)}, r"expected K \(nx, ny\) = \(3, 3\)"),
        ({"process_noise": np.full((3, 3), np.nan)}, "finite numbers, without NaN"),
        ({"bounds": {"Lp": (0.0, -1.0)}}, "Lp"),
        ({"bounds": {"Lx": (0.0, 1.0)}}, "no parameter 'Lx'"),
    ],
)
def test_wrong_arguments_are_explained(given, message):
    with pytest.raises(ValueError, match=message):
        output_error(TRUTH, [noisy()], **given)


def test_wrong_records_are_explained():
    with pytest.raises(ValueError, match="no records"):
        output_error(TRUTH, [])
    with pytest.raises(ValueError, match="has no input 'ped'"):
        output_error(TRUTH, [noisy().select(("lat",), TRUTH.outputs)])
    with pytest.raises(ValueError, match="output 'p' is missing in every sample"):
        output_error(TRUTH, [replace(noisy(), y=noisy().y * [1, np.nan, 1])])
    with pytest.raises(ModelError, match="every parameter is fixed"):
        output_error(TRUTH, [noisy()], fixed=TRUTH.parameter_names())


@pytest.mark.second
def test_intervals_chosen_here_are_shortened_until_a_solve_ends(monkeypatch):
    run, tried = Search.run, []

    def stopping(search, programme, point, R, **given):
        """A solver that reaches its limit on intervals above one second."""
        length = programme.evaluator.layout.count.max() * 0.02
        tried.append(length)
        outcome = run(search, programme, point, R, **given)
        stopped = replace(outcome.solution, success=length < 1.0, status="iteration limit reached")
        return replace(outcome, solution=stopped)

    monkeypatch.setattr(Search, "run", stopping)
    monkeypatch.setattr(Search, "around", lambda _, outcome: outcome)
    stable = replace(TRUTH, Lv=-0.01)
    fit = output_error(stable, [noisy()])
    assert fit.success
    assert fit.interval < 1.0
    assert tried[0] > tried[-1]
    with pytest.raises(ConvergenceError, match="iteration limit reached"):
        output_error(stable, [noisy()], interval=2.0)  # the user's own stays


def test_five_samples_are_too_few():
    with pytest.raises(ValueError, match="too few to estimate from"):
        output_error(TRUTH, [noisy().between(3.0, 3.09)])


@pytest.mark.parametrize("level", [0.0, 0.7])
def test_an_output_that_never_moves_is_refused_by_name(level):
    record = noisy()
    y = record.y.copy()
    y[:, 0] = level
    with pytest.raises(ValueError, match=f"output '{TRUTH.outputs[0]}' never moves in any record"):
        output_error(TRUTH, [replace(record, y=y)])
