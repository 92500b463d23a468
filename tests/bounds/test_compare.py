"""Comparisons of bounds against closed-form constrained optima."""

import csv
from dataclasses import dataclass, replace

import numpy as np
import pytest
from truths.mixture import NOISE, Inline, Mixture, Positive, least_squares, record
from truths.structures import black_box

from casid import (
    DataWarning,
    Execution,
    Match,
    Model,
    NonlinearModel,
    OutputError,
    Record,
    Rows,
    Scalar,
    StateSpace,
    compare_bounds,
    parameter,
    simulate,
)
from casid.bounds.compare import _of_records
from casid.bounds.robust import weights
from casid.errors import unasked, warn
from casid.shooting.homogeneity import OPPOSED
from casid.shooting.whiteness import FED

OMEGA = np.geomspace(0.2, 8.0, 25)


OTHER = StateSpace([[-2.0, 1.0], [0.0, -0.7]], [[1.0], [1.0]], [[1.5, 0.4]], [[0.05]],
                   inputs=("u",), outputs=("y",))  # fmt: skip
TARGET = black_box(OTHER, (0.2, 8.0))
MATCHED = Match(norm="quadratic", omega=OMEGA, shift=0.0, weight="size")
HERE = Execution(executor=Inline())


S = 1j * OMEGA
PHI = np.column_stack([1 / (S + 3), 1 / (S + 1), np.ones_like(S)]) / np.sqrt(len(S))
G = OTHER.response(OMEGA)[:, 0, 0] / np.sqrt(len(S))


def minimum(rows, right):
    """Least mean |G(λ) - Ĝ|² under rows @ λ = right, and its derivative by right."""
    H, g = 2 * (PHI.conj().T @ PHI).real, 2 * (PHI.conj().T @ G).real
    E = np.atleast_2d(rows)
    K = np.block([[H, E.T], [E, np.zeros((len(E), len(E)))]])
    found = np.linalg.solve(K, np.concatenate([g, right]))
    return float(np.sum(np.abs(PHI @ found[:3] - G) ** 2)), -found[3:]


CASES = {
    "free": {},
    "bound": {"a": "< -2"},
    "fixed": {"a": -2},
    "tie": ["b = -2 a"],
    "side": ["a + b <= 1"],
    "room": ["a + b <= 2"],
    "both": {"d": "> 0.2", "constraints": ["a + b = 1"]},
}
CLOSED = {  # rows and right-hand sides of what holds the optimum
    "bound": ([[1, 0, 0]], [-2.0]),
    "fixed": ([[1, 0, 0]], [-2.0]),
    "tie": ([[2, 1, 0]], [0.0]),
    "side": ([[1, 1, 0]], [1.0]),
    "both": ([[0, 0, 1], [1, 1, 0]], [0.2, 1.0]),
}


@pytest.fixture(scope="module")
def matched():
    return compare_bounds(Mixture(), TARGET, cases=CASES, estimator=MATCHED, execution=HERE)


def multipliers(case):
    rows = [row.multiplier for row in case.parameters if row.active]
    return [*rows, *(row.multiplier for row in case.relations if row.active)]


@pytest.mark.parametrize("name", CLOSED)
@pytest.mark.second
def test_multipliers_are_the_derivatives_of_the_closed_form_cost(matched, name):
    cost, prices = minimum(*map(np.array, CLOSED[name]))
    assert matched[name].cost == pytest.approx(cost, rel=1e-7)  # the solver's tolerance is 1e-8
    np.testing.assert_allclose(multipliers(matched[name]), prices, rtol=1e-4)
    rows, right = map(np.array, CLOSED[name])
    for k in range(len(right)):  # and these are the slope of the optimal cost
        step = np.eye(len(right))[k] * 1e-4
        slope = (minimum(rows, right + step)[0] - minimum(rows, right - step)[0]) / 2e-4
        assert multipliers(matched[name])[k] == pytest.approx(slope, rel=1e-4)


def test_the_increase_predicted_is_exact_where_the_cost_is_quadratic(matched):
    for name in CLOSED:
        case = matched[name]
        assert case.increase == pytest.approx(minimum(*CLOSED[name])[0] - matched["free"].cost)
        assert case.predicted == pytest.approx(case.increase, rel=1e-4)


def test_an_inequality_with_room_costs_nothing(matched):
    (room,), (side,) = matched["room"].relations, matched["side"].relations
    assert not room.active
    assert room.multiplier == 0
    assert matched["room"].increase == pytest.approx(0, abs=1e-9 * matched["free"].cost)
    assert side.active
    assert side.multiplier < 0  # an upper side: moving it up lowers the cost


def test_held_directions_are_counted(matched):
    assert {name: matched[name].held for name in CASES} == {
        "free": 0, "bound": 1, "fixed": 1, "tie": 1, "side": 1, "room": 0, "both": 2,
    }  # fmt: skip
    assert matched.freest == "free"


def test_what_holds_a_parameter_is_told_row_by_row(matched):
    bound, fixed = (next(r for r in matched[n].parameters if r.name == "a") for n in CLOSED_A)
    assert bound.active
    assert bound.upper == -2
    assert fixed.lower == fixed.upper == fixed.value == -2
    assert fixed.multiplier == pytest.approx(bound.multiplier, rel=1e-4)
    assert np.isnan(fixed.std_error)


CLOSED_A = ("bound", "fixed")


# ---- output error --------------------------------------------------------------------------------


KNOWN = OutputError(R=np.array([[NOISE**2]]))
FLOWN = {"free": {}, "bound": {"a": "< 0.97"}, "tie": ["a = 2 b"], "signs": {"d": "> 0"}}


@pytest.fixture(scope="module")
def flown():
    return compare_bounds(
        Mixture(), [record()], cases=FLOWN, validation=[record(1)], estimator=KNOWN
    )


def test_output_error_prices_are_those_of_constrained_least_squares(flown):
    X, y = least_squares()
    free = np.linalg.lstsq(X, y)[0]
    covariance = np.linalg.inv(X.T @ X)
    for name, row, right in (("bound", [1, 0, 0, 0, 0, 0], 0.97), ("tie", [1, -2, 0, 0, 0, 0], 0)):
        e = np.array(row, dtype=float)
        gap, spread = e @ free - right, e @ covariance @ e
        case = flown[name]
        assert case.increase == pytest.approx(0.5 * gap**2 / spread, rel=1e-4)
        assert case.predicted == pytest.approx(case.increase, rel=1e-4)
        assert multipliers(case)[0] == pytest.approx(-gap / spread, rel=1e-4)
        held = covariance - np.outer(covariance @ e, covariance @ e) / spread
        errors = np.array([row.cramer_rao for row in case.parameters])
        inside = ~np.isnan(errors)
        assert inside.sum() == (2 if name == "bound" else 3)
        np.testing.assert_allclose(errors[inside], np.sqrt(np.diag(held)[:3])[inside], rtol=1e-4)
    free_errors = [row.cramer_rao for row in flown["free"].parameters]
    np.testing.assert_allclose(free_errors, np.sqrt(np.diag(covariance)[:3]), rtol=1e-4)


def test_the_likelihood_ratio_is_twice_the_increase(flown):
    case = flown["tie"]
    assert case.statistic == pytest.approx(2 * case.increase)
    assert case.freedom == 1
    assert 0 <= case.p_value <= 1
    assert flown["signs"].freedom == 0  # nothing is held beside the freest case
    assert flown["signs"].p_value == 1.0


def test_aicc_counts_what_is_free(flown):
    r = record()
    n, nuisance = r.N, 2 + 1  # initial states, bias; R is given
    for name, free in (("free", 3), ("tie", 2), ("bound", 2)):
        w = weights(flown[name].fit, np.eye(3))
        np.testing.assert_allclose(w, 1, atol=0.2)  # white: variance of 400 residuals, R given
        assert len(w) == free
        k = w.sum() + nuisance
        expected = 2 * flown[name].cost + 2 * k * n / (n - k - 1)
        assert flown[name].aicc == pytest.approx(expected, rel=1e-12)


class TwoSticks(Model):
    """p' = Lp p + Llat lat(t - tau) + Lped ped."""

    states, inputs, outputs = ("p",), ("lat", "ped"), ("p",)

    Lp: Scalar = parameter(default=-3.0, lower=-25.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=1.0, lower=0.0, upper=60.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=5.0, lower=0.0, upper=60.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.08, lower=0.0, upper=0.25, unit="s")

    def A(self) -> Rows:
        return [[self.Lp]]

    def B(self) -> Rows:
        return [[self.Llat, self.Lped]]

    def delays(self):
        return {"lat": self.tau}


@pytest.mark.second
def test_a_delay_of_nothing_is_held_and_spoils_no_other_error():
    rng = np.random.default_rng(4)
    t = np.arange(0, 10, 0.05)
    u = np.repeat(rng.choice([-1.0, 1.0], (10, 2)), 20, axis=0)
    y = TwoSticks().system().simulate(t, u) + NOISE * rng.standard_normal((len(t), 1))
    gone = {"tau = 0.06": 0.06, "tau = 0.2": 0.2}
    cases = {name: {"Llat": 0.0, "tau": value} for name, value in gone.items()}
    with pytest.warns(UserWarning, match="case 'clean': .* tau has no effect"):
        found = compare_bounds(
            TwoSticks(), Record(t, u, y, ("lat", "ped"), ("p",)), execution=HERE,
            cases={"free": {}, "clean": {"Llat": 0.0}} | cases, estimator=OutputError(),
        )  # fmt: skip
    clean = found["clean"]
    assert {row.name for row in clean.parameters if np.isnan(row.std_error)} == {"Llat", "tau"}
    for name in cases:
        assert found[name].aicc == pytest.approx(clean.aicc, abs=1e-3)
        for field in ("value", "std_error", "cramer_rao"):
            here, there = (
                [getattr(row, field) for row in case.parameters if row.name in ("Lp", "Lped")]
                for case in (clean, found[name])
            )
            np.testing.assert_allclose(here, there, rtol=1e-4)


def test_eigenvalues_and_unseen_records_are_told(flown):
    np.testing.assert_allclose(flown["free"].eigenvalues, [-1, -3])
    sigma = NOISE / np.std(record(1).y)
    # noise of 400 samples, less six unknowns
    assert flown["free"].rms == pytest.approx(sigma, rel=0.1)


@pytest.mark.second
def test_the_prediction_is_right_to_first_order():
    # Noise variances concentrated out: the cost is no longer quadratic.
    free = compare_bounds(Mixture(), [record()], cases={"free": {}})["free"].parameters[0]
    steps = (8.0, 4.0, 2.0)
    cases = {"free": {}} | {f"{k}": {"a": free.value - k * free.std_error} for k in steps}
    found = compare_bounds(Mixture(), [record()], cases=cases)
    off = [abs(found[f"{k}"].predicted / found[f"{k}"].increase - 1) for k in steps]
    assert off[-1] < 0.01
    assert off[0] / off[1] > 1.8  # halving the step halves the error at least
    assert off[1] / off[2] > 1.8


# ---- rows and tables -----------------------------------------------------------------------------


@pytest.mark.slow
def test_tables_are_the_same_every_time_and_in_any_process(tmp_path):
    cases = {f"a < {k}": {"a": f"< {k}"} for k in (0.99, 0.98, 0.97, 0.96)}
    texts = []
    for name, executor in (("one", Inline()), ("two", None)):  # five cases: processes
        found = compare_bounds(
            Mixture(),
            [record()],
            cases={"free": {}} | cases,
            execution=Execution(executor=executor),
        )
        found.to_csv(tmp_path / f"{name}.csv")
        files = (f"{name}.csv", f"{name}_cases.csv")
        texts.append([(tmp_path / file).read_text() for file in files] + [found.to_markdown()])
    assert texts[0] == texts[1]


def test_the_csv_holds_every_case_and_parameter(flown, tmp_path):
    flown.to_csv(tmp_path / "bounds.csv")
    with (tmp_path / "bounds.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * 3 + 1  # one relation
    row = next(r for r in rows if (r["case"], r["name"]) == ("bound", "a"))
    assert row["active"] == "true"
    assert float(row["multiplier"]) == pytest.approx(multipliers(flown["bound"])[0], rel=1e-9)
    with (tmp_path / "bounds_cases.csv").open() as file:
        cases = {r["case"]: r for r in csv.DictReader(file)}
    assert float(cases["tie"]["increase"]) == pytest.approx(flown["tie"].increase, rel=1e-9)


def test_parameters_are_sorted_by_price(flown):
    names = flown.ranked()
    price = [max(case.shares.get(name, 0.0) for case in flown.cases) for name in names]
    assert price == sorted(price, reverse=True)
    assert names[0] == "a"


@pytest.mark.second
def test_a_failed_case_is_a_row_with_its_reason():
    cases = {"free": {}, "impossible": ["a + b <= -1"]}
    found = compare_bounds(Positive(), [record()], cases=cases)
    assert found["free"].reason == ""
    assert "constraint 'a + b" in found["impossible"].reason
    assert "failed" in found.to_markdown()


@pytest.mark.second
def test_where_the_first_case_fails_the_others_are_told_of_all_the_same():
    cases = {"impossible": ["a + b <= -1"], "other": {"b": "< 8.9"}}
    found = compare_bounds(Positive(), [record()], cases=cases, execution=HERE)
    assert found.freest == "impossible"
    assert "constraint 'a + b" in found["impossible"].reason
    assert found["other"].reason == ""


def test_a_wrong_estimator_or_case_is_refused_at_once():
    with pytest.raises(ValueError, match="estimator = 'guess', expected Estimator"):
        compare_bounds(Mixture(), [record()], cases={"free": {}}, estimator="guess")
    with pytest.raises(ValueError, match="no parameter 'z'"):
        compare_bounds(Mixture(), [record()], cases={"free": {"z": 1.0}})


class Sinking(NonlinearModel):
    """w' = T - c w², flown at a T that is no balance of the reference condition."""

    states, inputs, outputs = ("w",), ("T",), ("w",)

    c: Scalar = parameter(default=0.1, lower=0.01, upper=1.0, unit="1/m")

    def derivatives(self, x, u):
        return [u.T - self.c * x.w**2]

    def reference(self):
        return {"w": 1.0, "T": 4.0}


def sinking(T, seed):
    t = 0.1 * np.arange(150)
    u = T + 0.3 * np.sign(np.sin(1.1 * t + seed)) * (t > 1)
    still = Record(t, u[:, None], np.zeros((150, 1)), ("T",), ("w",), f"at {T:g}")
    record = simulate(Sinking(c=0.2), still, {"w": np.sqrt(T / 0.2)})
    return record.with_noise({"w": 0.02}, np.random.default_rng(seed))


@pytest.mark.second
def test_eigenvalues_of_a_nonlinear_structure_are_those_in_balance_where_it_was_flown(tmp_path):
    settings = {
        "cases": {"free": {}}, "estimator": OutputError(biases=False), "execution": HERE,
    }  # fmt: skip
    unseen = sinking(3.2, 2)
    for validation, T, named in (([unseen], 3.2, "at 3.2"), ([], 1.8, "at 1.8")):
        found = compare_bounds(Sinking(), [sinking(1.8, 1)], validation=validation, **settings)
        case = found["free"]
        pole = -2 * np.sqrt(case.fit.model.c * T)  # -2 c w in balance, T = c w²
        assert case.eigenvalues[0] == pytest.approx(pole, rel=0.01)
        assert found.linearised_at == f"the trim of record {named}, in balance"
        assert f"linearised at {found.linearised_at}" in found.to_markdown()
        found.to_csv(tmp_path / "bounds.csv")
        with (tmp_path / "bounds_cases.csv").open(encoding="utf-8") as file:
            (row,) = csv.DictReader(file)
        assert row["linearised_at"] == found.linearised_at


@pytest.mark.second
def test_what_all_cases_hold_is_said_to_have_no_price(recwarn):
    def of(**cases):
        return compare_bounds(Mixture(), TARGET, cases=cases, estimator=MATCHED, execution=HERE)

    of(free={}, bound={"a": "< -2"})
    ours = {"bounds": {"a": (-50, -2)}, "estimator": MATCHED, "execution": HERE}
    own = compare_bounds(Mixture(), TARGET, cases={"free": {}, "narrow": {"a": "< -3"}}, **ours)
    assert any(row.active for row in own["free"].parameters)
    assert not recwarn
    of(wide={"a": "< 50"}, bound={"a": "< -2"})  # the structure's own bound holds nothing
    with pytest.warns(DataWarning, match="count from 'bound'.*in which a is on bounds narrower"):
        of(bound={"a": "< -2"}, narrow={"a": "< -3"})
    with pytest.warns(DataWarning, match="increases of 'other', which does not lie within it, may"):
        found = of(bound={"a": "< -3"}, other={"a": "< -2", "b": "< 8.9"})
    assert found["other"].increase < 0


def test_what_records_do_to_each_other_under_one_bound_is_told_of_no_case():
    told = f"{OPPOSED}: r0 and all others"
    said = {"free": ("few data",), "tie": (told, "few data")}
    assert _of_records(said, "free") == {"free": ("few data",), "tie": ("few data",)}
    of_all = {"free": (told,), "tie": ("few data", told)}
    assert _of_records({"free": (told,), "tie": ("few data",)}, "free") == of_all
    fed = f"{FED} (p), and later inputs"
    assert _of_records({"free": (fed,), "tie": ()}, "free") == {"free": (fed,), "tie": (fed,)}


@pytest.mark.second
def test_what_records_say_is_asked_of_the_freest_case_and_told_of_all(monkeypatch):
    asked = []

    def told(found, flown, names, *, fed_back):  # noqa: ARG001 - as it is called
        asked.append(names)
        warn(f"{OPPOSED}: r0 and all others")

    monkeypatch.setattr("casid.shooting.output_error.warn_of_contradiction", told)
    cases = {"tight": {"a": "< -2.5"}, "free": {}, "held": {"a": "fixed"}}
    settings = {"cases": cases, "execution": HERE, "estimator": OutputError()}
    with pytest.warns(DataWarning, match=f"^{OPPOSED}: r0") as said:  # of no case alone
        compare_bounds(Mixture(), [record()], **settings)
    assert len(asked) == len([each for each in said if OPPOSED in str(each.message)]) == 1
    with unasked():
        start = OutputError().fit(Mixture(), [record()])
    with pytest.warns(DataWarning, match=OPPOSED):  # the start may be of other records
        compare_bounds(Mixture(), [record()], start=start, **settings)
    assert len(asked) == 2


@pytest.mark.second
def test_the_guess_is_what_cases_refer_to_wherever_their_fits_start(tmp_path):
    model = Mixture(a=-2.0)
    cases = {"free": {}, "near": {"a": "±20 %"}, "held": {"a": "fixed"}}
    start = Mixture(a=1.0, b=0.7, d=0.0)
    found = compare_bounds(
        model, [record()], cases=cases, start=start, execution=HERE, estimator=OutputError()
    )
    found.to_csv(tmp_path / "bounds.csv")
    with (tmp_path / "bounds.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["kind"] == "parameter"]
    assert {(row["name"], float(row["guess"])) for row in rows} == {
        ("a", -2.0), ("b", model.b), ("d", model.d)
    }  # fmt: skip
    (near,) = (row for row in rows if (row["case"], row["name"]) == ("near", "a"))
    limits = [float(near[key]) for key in ("lower", "upper")]
    assert limits == pytest.approx([-2.4, -1.6])


class Folded(Model):
    """Gains of p and q on an ellipse, that of r right whatever k is."""

    states, inputs, outputs = ("p",), ("lat",), ("p", "q", "r")

    k: Scalar = parameter(default=-1.2, lower=-3.0, upper=3.0, unit="-")

    def A(self) -> Rows:
        return [[-2]]

    def B(self) -> Rows:
        return [[1]]

    def C(self) -> Rows:
        return [[self.cosine(2.0)], [2 * self.k / (1 + self.k**2)], [1]]

    def cosine(self, size):
        return size * (1 - self.k**2) / (1 + self.k**2)


def gains(p, q):
    """A target of these gains, and the k on the whole ellipse that is nearest to them."""
    names = {"inputs": ("lat",), "outputs": ("p", "q", "r")}
    target = StateSpace([[-2.0]], [[1.0]], [[p], [q], [1.0]], np.zeros((3, 1)), **names)
    k = np.linspace(-3.0, 3.0, 200_001)
    off = (2 * (1 - k**2) / (1 + k**2) - p) ** 2 + (2 * k / (1 + k**2) - q) ** 2
    return black_box(target, (0.2, 8.0)), k[off.argmin()]


@pytest.mark.second
def test_no_case_ends_in_a_minimum_that_one_within_it_beats(tmp_path):
    target, k = gains(1.0, 0.1)
    lower, upper = {"k": (-2.5, 0.2)}, {"k": "> 0.15"}
    settings = {
        "cases": {"free": {}, "lower": lower, "half": {"k": (-0.9, 3.0)}, "upper": upper},
        "estimator": MATCHED, "execution": Execution(folder=tmp_path),
    }  # fmt: skip
    found = compare_bounds(Folded(), target, **settings)
    for name in ("free", "half", "upper"):
        assert found[name].fit.model.k == pytest.approx(k, abs=1e-3)
    assert found["lower"].fit.model.k == pytest.approx(0.2)  # from what "free" has found then
    assert (found["free"].start, found["lower"].start) == ("upper", "free")
    written = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert compare_bounds(Folded(), target, **settings).to_markdown() == found.to_markdown()
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == written


@pytest.mark.second
def test_a_case_that_fails_is_fitted_from_one_within_it():
    target, k = gains(0.5, 0.3)  # of which the lower side explains nothing
    cases = {"free": {}, "upper": {"k": "> 0.15"}, "lower": {"k": "< -0.5"}}
    found = compare_bounds(Folded(), target, cases=cases, estimator=MATCHED, execution=HERE)
    assert found["free"].fit.model.k == pytest.approx(k, abs=1e-3)
    assert "explains nothing" in found["lower"].reason


@dataclass(frozen=True)
class Stubborn:
    """Starts the fit of one range where it will, wherever it is told to."""

    def fit(self, model, data, *, bounds, **more):
        if bounds["k"] == (-3.0, 3.0):
            model, more = replace(model, k=-1.2), more | {"near": None}
        return MATCHED.fit(model, data, bounds=bounds, **more)


@pytest.mark.second
def test_a_minimum_that_stays_local_is_told_and_of_ranges_apart_none_is(recwarn):
    target, _ = gains(1.0, 0.1)
    lower, upper = {"k": (-2.5, 0.1)}, {"k": "> 0.15"}
    settings = {"estimator": Stubborn(), "execution": HERE}
    compare_bounds(Folded(), target, cases={"lower": lower, "upper": upper}, **settings)
    assert not recwarn
    with pytest.warns(DataWarning, match="'upper' lies within 'free', yet its cost is lower by"):
        compare_bounds(Folded(), target, cases={"free": {}, "upper": upper}, **settings)
