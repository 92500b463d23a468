import numpy as np
import pytest
import scipy.optimize
from truths.structures import ACTUATOR, SECOND, TRUTH, HoverRoll, Lag, black_box

from casid import (
    Constraint,
    ConvergenceError,
    Match,
    Model,
    ModelError,
    Rows,
    Scalar,
    SolverOptions,
    StateSpace,
    match,
    parameter,
)


@pytest.mark.second
@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_match_recovers_an_unstable_delayed_structure_from_its_own_response(norm):
    fit = match(HoverRoll(), black_box(TRUTH.system()), norm=norm)
    np.testing.assert_allclose(fit.model.vector(), TRUTH.vector(), rtol=1e-6)
    assert fit.success
    assert fit.certificate.upper_bound < 1e-6
    assert fit.certificate.shift > TRUTH.system().poles()[0].real


def brute_force(omega, cost):
    """Best (a, k) on grids that close in on the best point ten times."""
    G = SECOND.response(omega)[:, 0, 0]
    centre, width = np.array([2.0, 2.0]), np.array([1.9, 1.9])
    for _ in range(12):
        a, k = (np.linspace(c - w, c + w, 41) for c, w in zip(centre, width, strict=True))
        error = k[None, :, None] / (1j * omega + a[:, None, None]) - G
        values = cost(np.abs(error))
        i, j = np.unravel_index(np.argmin(values), values.shape)
        centre, width = np.array([a[i], k[j]]), width * 0.5
    return values.min(), centre


def test_hinf_optimum_is_that_of_brute_force():
    omega = np.geomspace(0.1, 10.0, 40)
    best, _ = brute_force(omega, lambda e: e.max(axis=2))
    fit = match(Lag(), black_box(SECOND), norm="hinf", omega=omega, weight="size")
    # The peaks that match adds between the points can only raise the optimum, by less than 1 %
    # of its gap; brute force stops within the width of its last grid, 1.9/2^11.
    assert fit.cost == pytest.approx(best, rel=1e-3)


def test_quadratic_optimum_is_that_of_brute_force():
    omega = np.geomspace(0.1, 10.0, 40)
    best, where = brute_force(omega, lambda e: (e**2).mean(axis=2))
    fit = match(Lag(), black_box(SECOND), norm="quadratic", omega=omega, weight="size")
    assert fit.cost == pytest.approx(best, rel=1e-6)  # second order in the grid's width
    np.testing.assert_allclose(fit.model.vector(), where, atol=2e-3)


def test_relative_errors_are_matched_where_they_are_asked_for():
    omega = np.geomspace(0.1, 10.0, 40)
    size = np.abs(SECOND.response(omega)[:, 0, 0])
    best, where = brute_force(omega, lambda e: ((e / size) ** 2).mean(axis=2))
    fit = match(Lag(), black_box(SECOND), norm="quadratic", omega=omega, weight="relative")
    assert fit.cost == pytest.approx(best, rel=1e-6)
    np.testing.assert_allclose(fit.model.vector(), where, atol=2e-3)


@pytest.mark.second
def test_prior_values_draw_a_match_as_errors_of_a_hundredth_do():
    omega, prior, std = np.geomspace(0.1, 10.0, 40), 1.2, 0.03
    G = SECOND.response(omega)[:, 0, 0]
    price = 1e-4 * np.mean(np.abs(G) ** 2) / std**2

    def cost(x):
        error = np.mean(np.abs(x[1] / (1j * omega + x[0]) - G) ** 2)
        return error + price * (x[0] - prior) ** 2

    best = scipy.optimize.minimize(cost, [1.0, 1.0], tol=1e-12)
    free = match(Lag(), black_box(SECOND), norm="quadratic", omega=omega, weight="size")
    fit = match(
        Lag(),
        black_box(SECOND),
        norm="quadratic",
        omega=omega,
        priors={"a": (prior, std)},
        weight="size",
    )
    assert fit.cost == pytest.approx(best.fun, rel=1e-6)
    np.testing.assert_allclose(fit.model.vector(), best.x, rtol=1e-4)
    assert abs(fit["a"].value - free["a"].value) > 0.01
    assert fit["a"].prior_std == std
    held = match(Lag(), black_box(SECOND), omega=omega, priors={"a": (prior, 1e-4)}, weight="size")
    assert held["a"].value == pytest.approx(prior, abs=1e-3)


def test_certificate_bounds_the_norm_over_the_band():
    fit = match(Lag(), black_box(SECOND), norm="hinf")
    dense = np.geomspace(0.1, 10.0, 5000)
    error = fit.model.system().response(dense) - SECOND.response(dense)
    assert fit.certificate.grid_norm <= fit.certificate.upper_bound
    assert np.abs(error).max() <= fit.certificate.upper_bound
    assert fit.certificate.upper_bound <= 1.01 * fit.certificate.grid_norm


@pytest.mark.second
def test_certificate_holds_with_delays_and_unstable_poles():
    fit = match(HoverRoll(), black_box(ACTUATOR), omega=np.geomspace(0.1, 10.0, 9))
    assert fit["tau"].value > 0.1
    shift = fit.certificate.shift
    assert shift > ACTUATOR.poles()[0].real > 0
    dense = np.geomspace(0.1, 10.0, 5000)
    error = fit.model.system().response(dense, shift) - ACTUATOR.response(dense, shift)
    largest = np.linalg.norm(error, 2, axis=(1, 2)).max()
    assert largest <= fit.certificate.upper_bound <= 1.01 * fit.certificate.grid_norm
    # Nine points are too few: the peaks between them were added.
    assert len(fit.notes.sources[0].grid) > 9


@pytest.mark.second
def test_multiplier_is_the_price_of_the_bound():
    def cost(upper):
        omega, bounds = np.geomspace(0.1, 10.0, 200), {"a": (0.1, upper)}
        return match(
            Lag(), black_box(SECOND), norm="hinf", bounds=bounds, omega=omega, weight="size"
        )

    fit, step = cost(0.7), 1e-4
    slope = (cost(0.7 + step).cost - cost(0.7 - step).cost) / (2 * step)
    assert fit["a"].active
    assert fit["a"].multiplier < 0
    # Central differences of a smooth optimum: error of the order of the step, plus IPOPT's 1e-8.
    assert fit["a"].multiplier == pytest.approx(slope, rel=1e-2)


@pytest.mark.second
@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
@pytest.mark.parametrize("unit", [1e-8, 1.0, 1e8])
def test_a_constraint_has_the_price_of_the_bound_it_stands_for_in_whatever_unit(norm, unit):
    class Limited(Lag):
        def constraints(self):
            return (Constraint("most", unit * self.a, lower=-np.inf, upper=0.7 * unit),)

    kept = {"norm": norm, "omega": np.geomspace(0.1, 10.0, 200), "weight": "size"}
    bound = match(Lag(), black_box(SECOND), bounds={"a": (0.1, 0.7)}, **kept)
    fit = match(Limited(a=0.5), black_box(SECOND), **kept)
    (row,) = fit.constraints
    assert (row.active, fit.held) == (True, 1)
    assert row.multiplier * unit == pytest.approx(bound["a"].multiplier, rel=1e-3)
    assert fit["a"].value == pytest.approx(0.7, rel=1e-6)


@pytest.mark.second
def test_channels_are_found_by_name():
    system = TRUTH.system()
    shuffled = StateSpace(
        system.A,
        np.hstack([np.ones((3, 1)), system.B]),
        system.C[::-1],
        np.zeros((2, 2)),
        inputs=("ped", "lat"),
        outputs=("phi", "p"),
        delay=np.array([0.0, 0.07]),
    )
    fit = match(HoverRoll(), black_box(shuffled), norm="quadratic")
    np.testing.assert_allclose(fit.model.vector(), TRUTH.vector(), rtol=1e-6)


def test_missing_channel_is_named():
    with pytest.raises(ValueError, match="input 'u' is no input of the target, which has lat"):
        match(Lag(), black_box(TRUTH.system()))


def test_what_is_no_target_is_refused():
    with pytest.raises(ValueError, match="target = None, expected BlackBox or"):
        match(HoverRoll(), None)


def test_shift_left_of_a_pole_is_refused():
    with pytest.raises(ValueError, match="lies left of the black box's pole"):
        match(HoverRoll(), black_box(TRUTH.system()), shift=0.01)


def test_grid_outside_the_band_is_refused():
    with pytest.raises(ValueError, match=r"holds in 0\.1 to 10 rad/s only"):
        match(Lag(), black_box(SECOND), omega=np.array([1.0, 50.0]))


def test_unknown_norm_and_parameter_are_named():
    with pytest.raises(ValueError, match="norm='h2'"):
        match(Lag(), black_box(SECOND), norm="h2")
    with pytest.raises(ModelError, match="no parameter 'b'"):
        match(Lag(), black_box(SECOND), fixed=("b",))


def test_iteration_limit_leaves_the_best_iterate():
    with pytest.raises(ConvergenceError, match="iteration limit") as caught:
        match(HoverRoll(), black_box(SECOND_TWO), solver=SolverOptions(max_iterations=1))
    assert not caught.value.best.success
    assert np.isfinite(caught.value.best.model.vector()).all()


SECOND_TWO = StateSpace(SECOND.A, SECOND.B, np.eye(2), np.zeros((2, 1)),
                        inputs=("lat",), outputs=("p", "phi"))  # fmt: skip


class Runaway(Lag):
    """A lag without bounds: the nearest to a constant gain is infinitely fast."""

    a: Scalar = parameter(default=1.0, unit="1/s")
    k: Scalar = parameter(default=1.0, unit="-")


@pytest.mark.second
def test_optimum_at_infinity_is_not_believed():
    gain = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]],
                      inputs=("u",), outputs=("x",))  # fmt: skip
    with pytest.raises(ConvergenceError, match="runs away: the optimum is at infinity") as caught:
        match(Runaway(), black_box(gain))
    assert not caught.value.best.success


class Deaf(Model):
    """An output that the input does not reach."""

    states = ("x", "y")
    inputs = ("u",)
    outputs = ("y",)

    a: Scalar = parameter(default=1.0, lower=0.1, upper=10.0, unit="1/s")
    k: Scalar = parameter(default=1.0, lower=0.1, upper=10.0, unit="-")

    def A(self) -> Rows:
        return [[-self.a, 0], [0, -1]]

    def B(self) -> Rows:
        return [[self.k], [0]]


def test_parameter_without_effect_is_named():
    target = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=("u",), outputs=("y",))
    with pytest.raises(ModelError, match="a, k have no effect on any weighted response"):
        match(Deaf(), black_box(target))


def test_structure_that_explains_nothing_is_refused():
    against = StateSpace([[-1.0]], [[-1.0]], [[1.0]], [[0.0]], inputs=("u",), outputs=("x",))
    with pytest.raises(ConvergenceError, match="explains nothing of the target; its worst pair"):
        match(Lag(), black_box(against), bounds={"k": (0.0, 5.0)}, norm="quadratic")


# Phase that rises with frequency, as only a pole right of the line can follow.
LEAD = StateSpace([[-100.0, -2500.0], [1.0, 0.0]], [[1.0], [0.0]], [[-2500.0, -2500.0]], [[0.0]],
                  inputs=("u",), outputs=("x",))  # fmt: skip


@pytest.mark.second
@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_poles_stay_left_of_the_line_by_constraint(norm):
    bounds = {"a": (-20.0, 20.0)}
    free, kept = (
        Match(norm=norm, shift=0.0, stable_shift=stable, weight="size").fit(
            Lag(), black_box(LEAD, (0.3, 3.0)), bounds=bounds
        )
        for stable in (False, True)
    )
    assert free["a"].value < 0 < kept["a"].value
    assert free.cost < kept.cost
    assert kept.iterations < 200  # not step by step along the line, to the limit of 500


def test_notes_tell_what_holds_the_optimum():
    fit = match(Lag(), black_box(SECOND))
    band = fit.notes.sources[0]
    at = np.argmax(band.sigma[:, 0])
    assert band.omega[at] == fit.notes.peak.omega == fit.certificate.peak_omega
    assert (fit.notes.peak.output, fit.notes.peak.input) == ("x", "u")
    assert band.sigma.max() <= fit.certificate.upper_bound
    assert fit.notes.sources[0].share == 1.0
