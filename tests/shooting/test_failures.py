"""What output error refuses or disbelieves, in which words; and data that are no reason to."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import (
    TRUTH,
    Roll,
    excitation,
    flown,
    jittered,
    off,
    relative_error,
    with_holes,
    with_response,
)

from casid import Constraint, ConvergenceError, ModelError, Scalar, SolverOptions, parameter
from casid.model import free_parameters
from casid.shooting.output_error import OutputError, choose_interval, output_error
from casid.shooting.search import Search

NOISE = {"ay": 0.05, "p": 0.005, "phi": 0.005}


def noisy(seed=1):
    return flown(seed=seed).with_noise(NOISE, np.random.default_rng(seed))


# ---- data ---------------------------------------------------------------------------------------


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


def test_ties_hold_and_sharpen_what_they_tie():
    records = [noisy(1), noisy(2)]
    free, tied = output_error(Roll(), records), output_error(Tied(), records)
    assert tied["Ylat"].value == pytest.approx(0.2 * tied["Llat"].value, rel=1e-8)
    assert tied["Ylat"].std_error == pytest.approx(0.2 * tied["Llat"].std_error, rel=1e-6)
    assert tied["Ylat"].std_error < 0.5 * free["Ylat"].std_error
    assert tied.cost > free.cost


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


@pytest.mark.parametrize("R", [None, np.diag([0.05, 0.005, 0.005]) ** 2])
def test_the_start_from_a_neighbour_changes_the_effort_only(R):
    records = [noisy(1), noisy(2)]
    wide = output_error(off(), records, R=R)
    bounds = {"Lp": (-1.9, 0.0), "Lv": (-1.0, -0.16)}
    cold = output_error(off(), records, R=R, bounds=bounds)
    warm = OutputError(R=R).fit(off(), records, bounds=bounds, near=wide)
    assert warm.iterations <= cold.iterations / 2
    # Each bound's share of the barrier is at most 1e-8 per observation.
    n = sum(record.y.size for record in records)
    assert warm.cost == pytest.approx(cold.cost, abs=2e-8 * n)
    for one, other in zip(warm.parameters, cold.parameters, strict=True):
        # Both stop with slopes per observation of 1e-8 at most, a fraction of 1e-4 of these prices.
        assert one.value == pytest.approx(other.value, rel=1e-6)
        assert one.multiplier == pytest.approx(other.multiplier, rel=1e-4, abs=1e-3)
        assert one.active == other.active == (one.name in bounds)


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


# ---- information --------------------------------------------------------------------------------


class Twin(Roll):
    """Two parameters that only show as a sum."""

    Lextra: Scalar = parameter(default=0.5, lower=-10.0, upper=10.0, unit="rad/s^2")

    def B(self):
        return [[self.Ylat, 0], [self.Llat + self.Lextra, self.Lped], [0, 0]]


def test_parameters_that_show_only_together_are_named():
    with pytest.raises(ConvergenceError, match="do not determine Llat, Lextra") as caught:
        output_error(Twin(), [noisy()])
    best = caught.value.best
    assert np.isinf(best["Llat"].std_error)
    assert np.isinf(best["Lextra"].std_error)
    assert best["Lp"].std_error < 0.1
    assert best["Llat"].value + best["Lextra"].value == pytest.approx(TRUTH.Llat, rel=0.01)
    assert output_error(Twin(), [noisy()], fixed=("Lextra",)).success


def test_a_control_that_never_moves_is_named_and_the_rest_estimated():
    record = noisy()
    still = replace(record, u=record.u * [1, 0])
    with pytest.raises(ConvergenceError, match=r"do not determine Lped .* add a manoeuvre"):
        output_error(TRUTH, [still])


def test_culprits_of_a_near_singular_information_are_named():
    record = noisy()
    pedal_as_stick = 0.5 * record.u[:, :1] + 0.002 * excitation(record.t, 9)[:, 1:]
    record = replace(record, u=np.hstack([record.u[:, :1], pedal_as_stick]))
    record = with_response(record, TRUTH).with_noise(NOISE, np.random.default_rng(2))
    fit = output_error(TRUTH, [record], fixed=("tau",))
    worst = fit.notes.collinear[0]
    assert {"Llat", "Lped"} <= set(worst.names)
    assert not {"Yv", "Lv", "Ylat"} & set(worst.names)
    assert worst.condition > 30
    names = list(fit.free_names)
    i, j = names.index("Llat"), names.index("Lped")
    assert fit.notes.correlation[i][j] < -0.9  # what one takes the other gives
    assert output_error(TRUTH, [noisy()]).notes.collinear == ()


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


def test_a_start_that_falls_over_in_the_data_is_caught_by_the_intervals():
    start = replace(TRUTH, Lp=0.0, Lv=1.0)
    assert start.system().poles()[0].real > 1.5  # e-fold 18 times over the record
    assert relative_error(output_error(start, [flown(seed=1)])).max() < 1e-6


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
        ({"interval": np.nan}, "expected seconds above 0"),
        ({"R": np.eye(2)}, r"expected \(ny, ny\) = \(3, 3\)"),
        ({"R": -np.eye(3)}, "not symmetric positive definite"),
        ({"R": "banded"}, 'expected "diagonal", "full" or'),
        ({"process_noise": np.eye(2)}, r"expected K \(nx, ny\) = \(3, 3\)"),
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


class Loaded(type(TRUTH)):
    """Roll with constant forces, as the response to a third input that never moves."""

    inputs = ("lat", "ped", "one")

    L0: Scalar = parameter(default=0.0, unit="rad/s^2")
    Y0: Scalar = parameter(default=0.0, unit="m/s^2")

    def B(self):
        return [[self.Ylat, 0, self.Y0], [self.Llat, self.Lped, self.L0], [0, 0, 0]]

    def D(self):
        return [[self.Ylat, 0, 0], [0, 0, 0], [0, 0, 0]]


def test_constant_forces_beside_output_biases_are_not_determined_and_no_success():
    # A shift of the states, taken back by biases and initial states, is a constant force.
    records = [
        replace(r, u=np.column_stack([r.u, np.ones(r.N)]), inputs=Loaded.inputs)
        for r in (noisy(1), noisy(2))
    ]
    with pytest.raises(ConvergenceError, match="do not determine L0, Y0") as caught:
        output_error(Loaded(), records)
    best = caught.value.best
    assert not best.success
    assert np.isinf([best["L0"].std_error, best["Y0"].std_error, best["Y0"].cramer_rao]).all()
    alone = output_error(TRUTH, [noisy(1), noisy(2)])
    for row in alone.parameters:  # the others are as if the forces were not there
        assert best[row.name].value == pytest.approx(row.value, abs=1e-3 * row.std_error)
        assert best[row.name].std_error == pytest.approx(row.std_error, rel=1e-3)
    known = output_error(Loaded(), records, biases=False)
    assert np.isfinite([row.std_error for row in known.parameters]).all()


def test_an_exactly_singular_factor_is_told_with_the_best_fit(monkeypatch):
    def singular(*_):
        raise RuntimeError("Factor is exactly singular")

    monkeypatch.setattr("casid.shooting.uncertainty.eliminate", singular)
    with pytest.raises(ConvergenceError, match="do not determine Yv") as caught:
        output_error(TRUTH, [noisy()])
    best = caught.value.best
    assert not best.success
    assert best.model.Lp == pytest.approx(TRUTH.Lp, rel=0.1)
    assert all(np.isinf(row.std_error) for row in best.parameters)


def test_intervals_chosen_here_are_shortened_until_a_solve_ends(monkeypatch):
    run, tried = Search.run, []

    def stopping(search, programme, point, R):
        """A solver that reaches its limit on intervals above one second."""
        length = programme.evaluator.layout.count.max() * 0.02
        tried.append(length)
        outcome = run(search, programme, point, R)
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
