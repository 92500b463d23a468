"""Any structure: random ones never leave a bare traceback, and known kinds are recovered."""

import warnings
from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from truths.structures import black_box

from casid import (
    ConvergenceError,
    DataWarning,
    Fit,
    Model,
    SolverOptions,
    StateSpace,
    match,
    parameter,
)

FEW = SolverOptions(max_iterations=150)


def build(truth, *, free=None, delays=None, bounds=(-50.0, 50.0), guess=0.3):
    """A structure with the pattern of a system: its free entries, guessed by sign, and delays.

    ``free`` maps "A", "B", "C", "D" to boolean patterns; other entries are known numbers.
    """
    body = {"states": truth.states, "inputs": truth.inputs, "outputs": truth.outputs}
    kept, notes = {}, {}
    for letter in "ABCD":
        M, F = getattr(truth, letter), (free or {}).get(letter)
        for i, j in [] if F is None else zip(*np.nonzero(F), strict=True):
            kept[f"{letter.lower()}{i}_{j}"] = M[i, j]
            default = float(np.clip(guess * np.sign(M[i, j]), *bounds))
            body[f"{letter.lower()}{i}_{j}"] = parameter(
                default=default, lower=bounds[0], upper=bounds[1], unit="-", scale=1.0
            )
        body[letter] = _rows(letter, M, F)
    for j in delays or ():
        body[f"tau{j}"] = parameter(default=0.0, lower=0.0, upper=0.5, unit="s")
        kept[f"tau{j}"] = truth.delay[j]
    if delays:
        body["delays"] = lambda self: {truth.inputs[j]: getattr(self, f"tau{j}") for j in delays}
    notes = dict.fromkeys(kept, float)
    cls = type("Structure", (Model,), body | {"__annotations__": notes, "__module__": __name__})
    return cls, np.array(list(kept.values()))


def _rows(letter, M, F):
    def rows(self):
        known = M.tolist()
        for i, j in [] if F is None else zip(*np.nonzero(F), strict=True):
            known[i][j] = getattr(self, f"{letter.lower()}{i}_{j}")
        return known

    return rows


def system(A, B, C, D=None, delay=()):
    A, B, C = (np.atleast_2d(np.array(M, dtype=float)) for M in (A, B, C))
    D = np.zeros((len(C), B.shape[1])) if D is None else np.atleast_2d(np.array(D, dtype=float))
    return StateSpace(A, B, C, D, delay=np.array(delay))


def nonzero(M):
    return np.asarray(M) != 0


KINDS = {
    "more outputs than inputs": (
        system([[-1, 0.5], [0.3, -2]], [[1], [0.5]], np.vstack([np.eye(2), [[1, 1]]])), "AB", (0,)),
    "more inputs than outputs": (
        system([[-1.0]], [[1.0, -2.0, 0.5]], [[1.0]]), "AB", (0, 1, 2)),
    "direct terms": (
        system([[-1, 2], [-2, -1]], [[1, 0], [0, 1]], np.eye(2), [[0.5, 0.1], [0, -1]]), "ABD", ()),
    "integrator": (
        system([[-1.5, 0], [1, 0]], [[2], [0]], np.eye(2)), "B", (0,)),
    "double integrator": (
        system([[0, 0], [1, 0]], [[2.5], [0]], [[0, 1]]), "B", (0,)),
    "repeated poles": (
        system([[-2, 1], [0, -2]], [[0], [3]], np.eye(2)), "AB", ()),
    "lightly damped": (
        system([[-0.02, 3], [-3, -0.02]], [[1], [0]], np.eye(2)), "AB", ()),
    "unstable complex pair": (
        system([[0.2, 1], [-1, 0.2]], [[1], [1]], np.eye(2)), "AB", (0,)),
    "direct terms alone": (
        system([[-1.0]], [[1.0, 0.0]], [[1.0], [0.0]], [[0.0, 0.3], [2.0, 0.0]]), "D", (0, 1)),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
@pytest.mark.parametrize("kind", KINDS)
def test_structures_of_every_kind_are_recovered(kind, norm):
    truth, letters, delays = KINDS[kind]
    delay = np.zeros(truth.nu)
    delay[list(delays)] = 0.05 + 0.04 * np.arange(len(delays))
    truth = system(truth.A, truth.B, truth.C, truth.D, delay)
    free = {letter: nonzero(getattr(truth, letter)) for letter in letters}
    structure, values = build(truth, free=free, delays=delays)
    fit = match(structure(), black_box(truth), norm=norm)
    np.testing.assert_allclose(fit.model.vector(), values, rtol=1e-5)


def chain(n):
    """Coupled oscillators in a row, every velocity measured; n states."""
    rng = np.random.default_rng(n)
    A = np.zeros((n, n))
    for i in range(0, n, 2):
        A[i, i + 1], A[i + 1, i] = 1.0, -(0.5 + 0.7 * i)
        A[i + 1, i + 1] = -0.3 - 0.1 * i
        if i:
            A[i + 1, i - 2] = 0.3
    B = np.zeros((n, 2))
    B[1, 0], B[n - 1, 1] = 1.0, -2.0
    return system(A, B + 0.5 * (rng.random((n, 2)) < 0.2) * (np.arange(n)[:, None] % 2),
                  np.eye(n)[1::2])  # fmt: skip


@pytest.mark.slow
def test_twenty_states_are_recovered():
    truth = chain(20)
    free = {"A": nonzero(truth.A) & (np.arange(20)[:, None] % 2 == 1), "B": nonzero(truth.B)}
    structure, values = build(truth, free=free)
    fit = match(structure(), black_box(truth), norm="quadratic")
    np.testing.assert_allclose(fit.model.vector(), values, rtol=1e-4)


@pytest.mark.slow
def test_a_mode_that_decides_the_norm_leaves_the_others_determined():
    # Behind actuators a slow mode's peak is the largest error, whatever the fast ones do.
    truth, lag = chain(20), 15.0
    A = np.block([[truth.A, truth.B], [np.zeros((2, 20)), -lag * np.eye(2)]])
    B, C = np.vstack([np.zeros((20, 2)), lag * np.eye(2)]), np.hstack([truth.C, np.zeros((10, 2))])
    free = {"A": nonzero(truth.A) & (np.arange(20)[:, None] % 2 == 1), "B": nonzero(truth.B)}
    structure, _ = build(truth, free=free)
    target = black_box(system(A, B, C))
    fits = {
        norm: match(structure(), target, norm=norm, weight="size") for norm in ("quadratic", "hinf")
    }
    fit = fits["hinf"]
    assert fit.certificate.upper_bound <= 1.01 * fit.certificate.grid_norm
    assert fit.cost < fits["quadratic"].certificate.grid_norm
    # Elsewhere it stays as good as that allows: 15 % above the least mean square.
    points = fit.notes.sources[0]
    assert points.sum_of_squares / len(points.grid) < 1.5 * fits["quadratic"].cost


@pytest.mark.second
@pytest.mark.parametrize("order", [1, 6])
def test_black_box_order_need_not_be_the_structures(order):
    truth, _, _ = KINDS["more outputs than inputs"]
    rng = np.random.default_rng(order)
    A = np.diag(-np.linspace(1.0, 9.0, order))
    other = system(A, rng.standard_normal((order, 1)), rng.standard_normal((3, order)))
    structure, _ = build(truth, free={"A": nonzero(truth.A), "B": nonzero(truth.B)})
    # An order less than the structure's leaves some of its parameters open.
    told = pytest.warns(DataWarning, match="do not determine a0_0") if order == 1 else nullcontext()
    with told:
        fit = match(structure(), black_box(other))
    assert fit.certificate.upper_bound <= 1.01 * fit.certificate.grid_norm


@st.composite
def problems(draw):
    """A random structure, and a random target in its channels or its own response."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    nx, nu, ny = (draw(st.integers(1, most)) for most in (5, 3, 3))
    A = rng.standard_normal((nx, nx)) * (rng.random((nx, nx)) < 0.6)
    A -= np.eye(nx) * draw(st.sampled_from([0.0, 0.5, 2.0]))
    B, C = rng.standard_normal((nx, nu)), rng.standard_normal((ny, nx))
    D = rng.standard_normal((ny, nu)) * draw(st.booleans())
    delays = draw(st.sampled_from([(), (0,)]))
    truth = system(A, B, C, D, [0.1 if j in delays else 0.0 for j in range(nu)])
    letters = draw(st.sampled_from(["A", "AB", "B", "ABD", "AC"]))
    free = {
        x: nonzero(getattr(truth, x)) & (rng.random(getattr(truth, x).shape) < 0.7) for x in letters
    }
    if not any(F.any() for F in free.values()):
        free["B"] = np.ones((nx, nu), dtype=bool)
    bounds = draw(st.sampled_from([(-50.0, 50.0), (-np.inf, np.inf), (-0.5, 0.5)]))
    structure, _ = build(truth, free=free, delays=delays, bounds=bounds)
    if draw(st.booleans()):
        order = draw(st.integers(1, 6))
        P = rng.standard_normal((order, order)) - draw(st.sampled_from([0.0, 3.0])) * np.eye(order)
        truth = system(P, rng.standard_normal((order, nu)), rng.standard_normal((ny, order)), D)
    return (
        structure(),
        truth,
        draw(st.sampled_from(["quadratic", "hinf"])),
        draw(st.sampled_from([None, "relative"])),
    )


def attempt(problem):
    """The fit and whether it was believed; a refusal of the arguments gives None."""
    model, truth, norm, weight = problem
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)  # of what A and C alone leave open
            return match(model, black_box(truth), norm=norm, weight=weight, solver=FEW)
    except ConvergenceError as error:
        return error.best
    except ValueError as error:
        return error


def check(problem):
    fit = attempt(problem)
    if isinstance(fit, ValueError):
        assert len(str(fit)) > 30  # says what to do
        return
    assert isinstance(fit, Fit)
    assert np.isfinite(fit.model.vector()).all()
    for row in fit.parameters:
        assert row.lower <= row.value <= row.upper
    if fit.success:
        certificate = fit.certificate
        assert certificate.grid_norm <= certificate.upper_bound * (1 + 1e-9)
        if fit.method == "match hinf":
            assert fit.cost == pytest.approx(certificate.grid_norm, rel=1e-6)
        line = certificate.shift
        assert fit.model.system().poles()[0].real <= line + 2e-6 * (1 + line)


HEALTH = [HealthCheck.too_slow, HealthCheck.data_too_large]


@pytest.mark.slow
@given(problems())
@settings(suppress_health_check=HEALTH, deadline=None, max_examples=5)
def test_random_structures_leave_a_fit_or_a_typed_error(problem):
    check(problem)


@pytest.mark.campaign
@given(problems())
@settings(suppress_health_check=HEALTH, deadline=None, max_examples=400)
def test_many_random_structures_leave_a_fit_or_a_typed_error(problem):
    check(problem)
