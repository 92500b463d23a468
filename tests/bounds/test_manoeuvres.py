"""Structures side by side on manoeuvres left out."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
import scipy.signal
from truths.closed_roll import NOISE, TRUTH, Roll, T, campaign
from truths.mixture import Inline
from truths.structures import HoverRoll

from casid import (
    ConvergenceError,
    DataWarning,
    Execution,
    Match,
    Model,
    NonlinearModel,
    OutputError,
    Record,
    Scalar,
    compare_structures,
    output_error,
    parameter,
    summary,
    validate,
)
from casid.bounds.manoeuvres import StructureComparison, Without, _biased, _judged

RECORDS = campaign(1)
HERE = Execution(executor=Inline())


class Bare(Roll):
    """Pedals do not roll it."""

    Lped: Scalar = parameter(default=0.0, lower=0.0, upper=0.0, unit="rad/s^2")


@dataclass(frozen=True)
class Failing:
    """Refuses whatever it is given."""

    tried: ClassVar[int] = 0

    def fit(self, *_, **__):
        Failing.tried += 1
        raise ValueError("of no use")


def of_model(model):
    """A fit that ended at this model."""
    others = set(model.parameter_names()) - {"Llat"}
    return replace(output_error(TRUTH, RECORDS[0], fixed=others), model=model)


@dataclass(frozen=True)
class Stuck:
    """Has something to show of fewer records, or of all, and says that it is no solution."""

    everywhere: bool = False

    def fit(self, model, records, **_):
        found = OutputError(domain="frequency").fit(model, records)
        if self.everywhere or len(records) < len(RECORDS):
            raise ConvergenceError("stuck", found)
        return found


def comparison(sizes, parameters, noise=0.0):
    errors = np.exp(np.array(sizes, dtype=float))[:, :, None] * np.ones((1, 1, 2))
    return StructureComparison(
        names=tuple("abc"[: len(sizes)]), manoeuvres=("x", "y", "z"), outputs=("p", "phi"),
        errors=errors, parameters=tuple(parameters), aicc=np.zeros(len(sizes)),
        fits=(None,) * len(sizes), reasons={}, noise=np.full(2, noise),
    )  # fmt: skip


def test_the_simplest_that_is_not_significantly_worse_is_named():
    sizes = [[0.0, 0.1, 0.2], [0.1, 0.0, 0.2], [1.0, 1.1, 1.2]]
    found = comparison(sizes, [9, 7, 3])
    assert found.best == "a"
    assert found.simplest == "b"  # as large but for the order; c is 1 ± 0 above
    assert comparison([*sizes[:2], [0.001, 0.101, 0.201]], [9, 7, 3]).simplest == "b"
    mean, error = found.excess
    np.testing.assert_allclose(mean, [0.0, 0.0, 1.0], atol=1e-12)
    without = [(0.1, 0.2, 0.0, 0.2), (0.0, 0.2, 0.1, 0.2), (0.0, 0.1, 0.1, 0.0)]
    apart = [np.log((np.exp(2 * c) + np.exp(2 * d)) / (np.exp(2 * a) + np.exp(2 * b))) / 2
             for a, b, c, d in without]  # fmt: skip
    np.testing.assert_allclose(error, [0.0, np.sqrt(2 / 3 * np.sum(np.square(apart))), 0.0],
                               atol=1e-12)  # fmt: skip


@pytest.mark.parametrize("n", [3, 4, 8])
@pytest.mark.second
def test_a_structure_as_good_is_worse_by_chance_as_rarely_as_student_says(n):
    rng = np.random.default_rng(n)
    named, missed = [], []
    for _ in range(400):
        level = rng.normal(0.0, 0.5, n)
        apart = rng.normal(0.0, 0.02, n)
        for gain, found in ((0.0, named), (0.2, missed)):
            errors = np.exp([level, level + apart + gain])[:, :, None]
            each = StructureComparison(
                names=("rich", "simple"), manoeuvres=tuple("abcdefgh"[:n]), outputs=("p",),
                errors=errors, noise=np.zeros(1), parameters=(9, 3), aicc=np.zeros(2),
                fits=(None, None), reasons={},
            )  # fmt: skip
            found.append(each.simplest == "simple")
    # One standard error: 0.79 of three, 0.83 of eight.
    assert np.mean(named) == pytest.approx(0.9, abs=0.04)
    assert np.mean(missed) < 0.01


def test_noise_that_nothing_predicts_counts_for_neither():
    own = np.array([[1.0, 1.0, 1.0], [1.2, 1.2, 1.2]])
    found = comparison(np.log(own**2 + 0.9 * 3.0**2) / 2, [9, 9], noise=3.0)
    np.testing.assert_allclose(found.excess[0], [0.0, np.log(1.2)], rtol=1e-9)
    np.testing.assert_allclose(found.excess[1], 0.0, atol=1e-9)
    hidden = comparison(np.log([[3.0] * 3, [3.3] * 3]), [9, 9], noise=100.0)  # more than there is
    np.testing.assert_allclose(hidden.excess[0], [0.0, np.log(1.1)], rtol=1e-9)


def test_what_a_manoeuvre_does_not_measure_counts_for_no_candidate():
    sizes = [[0.0, 0.1, 0.2], [0.4, 0.5, 0.6]]
    found = comparison(sizes, [9, 7])
    errors = found.errors.copy()
    errors[:, 1, 1] = np.nan  # the second manoeuvre has no phi
    without = replace(found, errors=errors)
    np.testing.assert_allclose(without.excess[0], [0.0, 0.4], rtol=1e-9)
    assert without.simplest == "a"
    errors[:, :, 1] = np.nan  # nor has any other
    np.testing.assert_allclose(replace(found, errors=errors).excess[0], [0.0, 0.4], rtol=1e-9)
    errors[1, 2, 0] = np.inf  # one failed
    assert replace(found, errors=errors).excess[0][1] == np.inf
    lost = replace(found, errors=np.full(errors.shape, np.inf), reasons={"a, all": "singular"})
    with pytest.raises(ConvergenceError, match=r"every candidate failed:\na, all: singular$"):
        assert lost.simplest


@pytest.mark.parametrize(("size", "hidden"), [(0.1, True), (1.0, False)])
def test_errors_below_the_noise_differ_by_more_than_is_told_and_it_is_said(size, hidden):
    own = size * np.array([[1.0, 1.1, 0.9], [1.0, 0.9, 2.3]])  # 1.53 times as large
    found = comparison(np.log(own**2 + 1.0) / 2, [9, 3], noise=1.0)
    assert found.hidden is hidden
    assert (np.exp(found.excess[0][1]) < 1.3) == hidden
    assert (found.best, found.simplest) == ("a", "b")
    assert (", at least: errors are below the noise)" in found.headline()) is hidden


def test_the_headline_says_what_the_simplest_loses():
    found = comparison([[0.0, 0.1, 0.2], [0.3, 0.0, 0.2]], [9, 3])
    mean, error = (100 * each[1] for each in (np.expm1(found.excess[0]), found.excess[1]))
    error *= 1 + mean / 100
    told = f"best a, the simplest that is not worse b ({mean:+.0f} % ± {error:.0f} %"
    assert (round(mean), round(error)) == (8, 13)  # ½ ln(4.314 / 3.713) = 0.075, worked out by hand
    assert found.headline().endswith(f"{told}, AICc +0)")
    likelier = replace(found, aicc=np.array([-20.0, 34.0]))
    assert likelier.headline().endswith(f"{told}, AICc +54)")
    unknown = replace(found, aicc=np.full(2, np.nan))
    assert unknown.headline().endswith(f"{told})")


def test_a_candidate_that_fails_everywhere_leaves_the_others_in_their_order():
    found = comparison([[1.0, 1.1, 1.2], [0.0, 0.1, 0.2], [np.inf] * 3], [3, 9, 9])
    assert (found.best, found.simplest) == ("b", "b")
    np.testing.assert_allclose(found.excess[0][:2], [1.0, 0.0], atol=1e-12)
    once = comparison([[1.0, 1.1, np.inf], [0.0, 0.1, np.inf], [0.5, np.inf, np.inf]], [3, 9, 9])
    assert once.best == "b"  # of those that failed least


def test_a_candidate_that_failed_is_said_to_with_its_reason():
    found = comparison([[0.0, 0.1, 0.2], [0.4, 0.5, np.inf]], [9, 7])
    found = replace(found, aicc=np.array([12.0, np.nan]), reasons={"b, all": "stuck"})
    table = found.to_markdown()
    assert "| b | 7 | failed |  |" in table
    assert table.endswith("\n\n- b, all: stuck")
    assert "best a, the simplest that is not worse a" in summary(found)
    assert table.startswith(summary(found).partition("\n\n")[2].rstrip())
    lost = replace(found, errors=np.full(found.errors.shape, np.inf))
    assert lost.headline().endswith("every candidate failed")


class Bank(Model):
    """Roll and its integral, a slow mode beside it or not."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("p", "phi")

    Lp: Scalar = parameter(default=-2.0, lower=-10.0, upper=0.0, unit="1/s")
    Lphi: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="1/s^2")
    Llat: Scalar = parameter(default=8.0, lower=0.0, upper=50.0, unit="1/s^2")

    def A(self):
        return [[self.Lp, self.Lphi], [1, 0]]

    def B(self):
        return [[self.Llat], [0]]


class Integral(Bank):
    """No moment of bank."""

    Lphi: Scalar = parameter(default=0.0, lower=0.0, upper=0.0, unit="1/s^2")


@pytest.mark.campaign
@pytest.mark.parametrize(
    "biased",
    [("p", "phi"), *(pytest.param(each, marks=pytest.mark.campaign) for each in (("phi",), ()))],
    ids=len,
)
@pytest.mark.parametrize(
    "slow", [0.0, pytest.param(-0.3, marks=pytest.mark.campaign)], ids=["integral", "slow"]
)
def test_states_that_follow_the_record_gain_nothing_by_its_noise(slow, biased):
    """Noise alone, that states and biases of a structure take a part of: expected is its size."""
    fit = replace(output_error(Integral(), banked(1)[0], fixed=("Lp",)), model=Bank(Lphi=slow))
    rng, t, squares = np.random.default_rng(5), 0.05 * np.arange(40), []
    for _ in range(400):
        y = [1.0, 3.0] * rng.standard_normal((40, 2))
        record = Record(t, np.zeros((40, 1)), y, ("lat",), ("p", "phi"), "noise")
        errors, _ = _judged([fit], record, ("p", "phi"), biased)
        squares.append((errors[0] / [1.0, 3.0]) ** 2)
    scatter = np.std(squares, axis=0) / np.sqrt(len(squares))
    np.testing.assert_allclose((np.mean(squares, axis=0) - 1) / scatter, 0.0, atol=3.5)
    assert (scatter < 0.014).all()  # one unknown of 40 samples is told


@pytest.mark.second
def test_what_no_estimator_takes_for_a_bias_is_an_error_of_the_manoeuvre():
    fit = replace(output_error(Integral(), banked(1)[0], fixed=("Lp",)), model=Bank(Lphi=-0.3))
    t, none = 0.05 * np.arange(100), np.zeros((100, 1))
    y = np.column_stack([np.zeros(100), np.full(100, 0.5)])
    record = Record(t, none, y, ("lat",), ("p", "phi"), "offset")
    taken, own, left = (
        _judged([fit], record, ("p", "phi"), biased)[0][0, 1]
        for biased in (("p", "phi"), ("phi",), ("p",))
    )
    assert max(taken, own) < 1e-6
    assert left > 0.05  # bank decays, a bias does not
    outputs = Bank.outputs
    given = (OutputError(), OutputError(biases=False), OutputError(biases=("p",)), Match())
    assert [tuple(_biased(each, outputs)) for each in given] == [outputs, (), ("p",), outputs]


class Curved(NonlinearModel):
    """The same by equations."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("p", "phi")

    Lp: Scalar = parameter(default=-2.0, lower=-10.0, upper=0.0, unit="1/s")

    def derivatives(self, x, u):
        return [self.Lp * x.p - 0.3 * x.phi + 8.0 * u.lat, x.p]

    def measurements(self, x, u):  # noqa: ARG002
        return [x.p, x.phi]


def test_states_and_biases_of_nonlinear_structures_take_as_much_of_every_output():
    fit = replace(output_error(Integral(), banked(1)[0], fixed=("Lp",)), model=Curved())
    record = banked(2)[0]
    errors, _ = _judged([fit], record, record.outputs, record.outputs)
    rms = validate({"curved": Curved()}, record).rms["curved"][0]
    np.testing.assert_allclose(errors[0], rms * np.sqrt(200 / (200 - (1 + 2 / 2))), rtol=1e-9)


def banked(seed):
    """Six short manoeuvres in white noise, of roll that integrates to bank."""
    rng, t, decay = np.random.default_rng(seed), 0.05 * np.arange(200), np.exp(-0.1)
    found = []
    for k in range(6):
        u = 0.2 * np.sign(np.sin(2 * np.pi * t / rng.uniform(2, 6) + rng.uniform(0, 6)))
        u[t < 1] = 0.0
        p = scipy.signal.lfilter([0, 4 * (1 - decay)], [1, -decay], u)
        phi = 4 * 0.05 * (np.cumsum(u) - u) - p / 2  # what p' = -2 p + 8 u says of ∫ p
        y = np.column_stack([p, phi]) + 0.02 * rng.standard_normal((200, 2))
        found.append(Record(t, u[:, None], y, ("lat",), ("p", "phi"), f"m{k}", "zoh"))
    return found


@pytest.mark.campaign
def test_a_slow_mode_is_no_line_for_what_drifts():
    """Truth integrates: with a bias of phi that nothing estimates, a slow mode predicted better."""
    named = [
        compare_structures(
            {"slow": Bank(), "integral": Integral()},
            banked(seed),
            estimator=OutputError(biases=("p",)),
            execution=HERE,
        )
        for seed in range(8)
    ]
    told = [each.simplest for each in named]
    assert told.count("integral") >= 6, told  # 90 % at least, if the errors were normal
    # By rank: AICc of truth is less by 2 in the mean, and of one parameter more at most by chi².
    gain = [each.aicc[0] - each.aicc[1] for each in named]
    assert np.mean(gain) > 0


@pytest.mark.second
def test_candidates_are_all_simulated_or_all_predicted():
    wild = replace(TRUTH, Yv=TRUTH.Yv + 2.5)  # by more than ten e-folds
    fits = [of_model(each) for each in (TRUTH, wild)]
    record = RECORDS[0]
    errors, _ = _judged(fits, record, record.outputs, record.outputs)
    (alone,), _ = _judged(fits[:1], record, record.outputs, record.outputs)
    found = validate({"right": TRUTH, "wild": wild}, record)
    assert np.isfinite(found.horizon[0])
    np.testing.assert_allclose(errors, [found.rms["right"][0], found.rms["wild"][0]])
    assert np.abs(errors[0] / alone - 1).max() > 0.01


def test_what_is_left_out_is_not_there():
    assert Without((1,))(tuple("abc")) == ("a", "c")


@pytest.mark.slow
def test_a_structure_that_lacks_a_derivative_is_not_enough():
    candidates = {"whole": TRUTH, "bare": Bare()}
    way = OutputError(domain="frequency")
    with pytest.warns(DataWarning, match="^candidate 'bare': .* follow the inputs"):
        found = compare_structures(candidates, RECORDS, estimator=way, execution=HERE)
    assert list(map(len, found.warnings.values())) == [0, 1]
    assert found.simplest == "whole"
    assert found.parameters == (7, 6)
    assert found.excess[0][1] > 0.1
    stated = [NOISE[name] for name in found.outputs]
    np.testing.assert_allclose(found.noise, stated, rtol=0.15)  # a median of 250 lines
    assert "| bare" in found.to_markdown()


@pytest.mark.second
def test_a_manoeuvre_is_judged_by_the_fit_that_has_not_seen_it():
    way = OutputError(domain="frequency")
    found = compare_structures({"whole": TRUTH}, RECORDS, estimator=way, execution=HERE)
    others = way.fit(TRUTH, RECORDS[1:], near=found.fits[0])
    expected, seen = (
        validate({"fit": fit}, RECORDS[0]).rms["fit"][0] for fit in (others, found.fits[0])
    )
    taken = len(T) * (1 - (expected / found.errors[0, 0]) ** 2)
    assert taken.sum() == pytest.approx(3 + 3, rel=1e-6)  # initial states and biases
    assert (taken > 1 - 1e-6).all()
    assert np.abs(seen / expected - 1).max() > 1e-3


@pytest.mark.slow
def test_what_is_no_solution_predicts_nothing():
    found = compare_structures({"whole": TRUTH}, RECORDS, estimator=Stuck(), execution=HERE)
    assert np.isinf(found.errors).all()
    assert {*found.reasons.values()} == {"stuck"}


@pytest.mark.second
def test_the_noise_of_outputs_that_share_no_sample_is_theirs():
    k = np.arange(len(T))
    turns = np.column_stack([k % 3 != j for j in range(3)])
    records = [record.mask(turns) for record in RECORDS]
    way = OutputError(interval=2.0)
    found = compare_structures({"whole": TRUTH}, records, estimator=way, execution=HERE)
    stated = [NOISE[name] for name in found.outputs]
    np.testing.assert_allclose(found.noise, stated, rtol=0.3)  # a median of 80 lines


@pytest.mark.slow
def test_one_structure_in_several_ways():
    ways = {"time": OutputError(interval=2.0), "frequency": OutputError(domain="frequency")}
    found = compare_structures(dict.fromkeys(ways, TRUTH), RECORDS, estimator=ways, execution=HERE)
    # The noise rules both errors: they agree to a percent.
    np.testing.assert_allclose(found.excess[0], 0.0, atol=0.01)
    assert not found.reasons
    assert np.isnan(found.aicc).all()  # two likelihoods of the same records


@pytest.mark.second
def test_a_way_that_fails_on_all_manoeuvres_is_not_tried_without_each():
    ways = {"time": OutputError(interval=2.0), "none": Failing()}
    found = compare_structures(dict.fromkeys(ways, TRUTH), RECORDS, estimator=ways, execution=HERE)
    assert found.reasons == {"none, all": "ValueError: of no use"}
    assert np.isfinite(found.errors[0]).all()
    assert np.isinf(found.errors[1]).all()
    assert found.fits[1] is None
    assert Failing.tried == 1


@pytest.mark.second
def test_the_best_iterate_of_a_candidate_that_failed_has_no_criterion():
    ways = {"frequency": OutputError(domain="frequency"), "stuck": Stuck(everywhere=True)}
    found = compare_structures(dict.fromkeys(ways, TRUTH), RECORDS, estimator=ways, execution=HERE)
    assert found.fits[1] is not None
    assert np.isnan(found.aicc).tolist() == [False, True]


@pytest.mark.campaign
def test_candidates_of_two_processes_are_those_of_one():
    ways = {"time": OutputError(interval=2.0), "frequency": OutputError(domain="frequency")}
    given = {"candidates": dict.fromkeys(ways, TRUTH), "records": RECORDS, "estimator": ways}
    one, two = (compare_structures(**given, execution=where) for where in (HERE, Execution()))
    np.testing.assert_allclose(two.errors, one.errors, rtol=1e-9)
    assert two.names == one.names


def test_comparisons_that_make_no_sense_are_refused():
    with pytest.raises(ValueError, match="2 manoeuvres"):
        compare_structures({"a": TRUTH}, RECORDS[:2])
    with pytest.raises(ValueError, match="no candidates"):
        compare_structures({}, RECORDS, execution=Execution())
    with pytest.raises(ValueError, match="'b' predicts p, phi, the first ay, p, phi"):
        compare_structures({"a": TRUTH, "b": HoverRoll()}, RECORDS)
    with pytest.raises(ValueError, match="no estimator for 'a'"):
        compare_structures({"a": TRUTH}, RECORDS, estimator={"b": OutputError()})


def test_candidates_that_all_failed_are_told_a_line_each():
    found = comparison(np.full((2, 3), np.inf), (1, 2))
    names = found.names
    why = {f"{names[0]}, all": "too steep", f"{names[0]}, without x": "no", f"{names[1]}, all": "?"}
    told = replace(found, reasons=why)
    with pytest.raises(ConvergenceError) as error:
        _ = told.simplest
    first, second = str(error.value).splitlines()[1:]
    assert first == f"{names[0]}, all (and 1 more): too steep"
    assert second == f"{names[1]}, all: ?"


@pytest.mark.slow
def test_a_record_without_one_of_the_outputs_is_predicted_in_the_others():
    y = RECORDS[1].y.copy()
    y[:, -1] = np.nan
    flown = [RECORDS[0], replace(RECORDS[1], y=y), *RECORDS[2:]]
    found = compare_structures({"whole": TRUTH, "bare": Bare()}, flown, execution=HERE)
    assert np.isnan(found.errors[:, 1, -1]).all()
    assert np.isfinite(found.errors).sum() == found.errors.size - 2
    assert found.simplest == "whole"
    assert np.isfinite(found.excess[0]).all()


def test_where_all_failed_on_a_manoeuvre_the_best_is_that_of_the_others():
    found = comparison([[0.5, 0.6, np.inf], [0.1, 0.2, np.inf]], [9, 7])
    assert found.best == "b"
    assert comparison([[np.inf, 0.0, 0.0], [0.5, 0.6, 0.7]], [9, 7]).best == "b"
    assert comparison([[np.inf] * 3, [np.inf] * 3], [9, 7]).best == "a"
