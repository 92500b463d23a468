"""What fits of a comparison warned of is told as a fit by itself tells it, once."""

import inspect
import warnings
from dataclasses import dataclass, replace

import pytest
from truths.mixture import TRUTH, Inline, Mixture, record

import casid
from casid import DataWarning, Execution, OutputError, compare_bounds, multistart
from casid.bounds.pooled_warnings import heard, kind, sentences, tell, tell_of_draws
from casid.bounds.reduction import ReductionRule
from casid.errors import warn

HERE = Execution(executor=Inline())
RECORDS = [record(seed) for seed in range(3)]
SAYS = "the gyro drifts by 0.5 deg/s; calibrate it"


@dataclass(frozen=True)
class Doubtful:
    """Output error that warns of each of its fits; of those that start beyond a, all cost more."""

    beyond: float = 9.0
    says: str = SAYS

    def fit(self, model, data, **more):
        fit = OutputError().fit(model, data, **more)
        if model.a <= self.beyond:
            warn(self.says)
            return fit
        warn("this one lost")
        return replace(fit, cost=fit.cost + 1)


def told(compute):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        compute()
    assert all(each.category is DataWarning for each in caught)
    assert {each.filename for each in caught} <= {__file__}
    return [str(each.message) for each in caught]


OWN = {"estimator": Doubtful(), "execution": HERE}
CALLS = {
    "compare_bounds": lambda: compare_bounds(
        Mixture(), RECORDS, cases={"free": {}, "tie": ["a = 2 b"]}, **OWN
    ),
    "compare_structures": lambda: casid.compare_structures({"x": Mixture()}, RECORDS, **OWN),
    "profile_parameters": lambda: casid.profile_parameters(
        Mixture(), RECORDS, values={"a": [0.99]}, **OWN
    ),
    "reduce_structure": lambda: casid.reduce_structure(
        Mixture(), RECORDS, rule=ReductionRule(replay={"d": 0.05}), **OWN
    ),
    "multistart": lambda: multistart(Mixture(), RECORDS, starts=2, **OWN),
    "monte_carlo": lambda: casid.monte_carlo(TRUTH, RECORDS, noise={"y": 0.02}, runs=3, **OWN),
    "bootstrap": lambda: casid.bootstrap(
        OutputError().fit(Mixture(), RECORDS), RECORDS, runs=3, **OWN
    ),
}


def test_no_comparison_is_missing_here():
    public = {name: getattr(casid, name) for name in casid.__all__}
    takes = {
        name
        for name, each in public.items()
        if inspect.isfunction(each) and "execution" in inspect.signature(each).parameters
    }
    assert takes == {*CALLS}


@pytest.mark.second
@pytest.mark.parametrize("name", CALLS)
def test_every_comparison_tells_what_a_fit_tells_once(name):
    assert told(lambda: Doubtful().fit(Mixture(), RECORDS)) == [SAYS]
    draws = "3 of 3 draws: " * (name in {"monte_carlo", "bootstrap"})
    assert told(CALLS[name]) == [draws + SAYS]


@pytest.mark.second
def test_starts_that_lose_stay_silent():
    few = {"starts": 3, "estimator": Doubtful(beyond=Mixture().a), "execution": HERE}
    assert told(lambda: multistart(Mixture(), RECORDS[:1], **few)) == [SAYS]


@pytest.mark.second
def test_a_prior_that_one_case_contradicts_is_told_of_that_case():
    # Held at the prior's value, nothing contradicts it; the records say a = 1.0 ± 0.01.
    cases = {"free": {}, "tie": ["a = 2 b"], "held": {"a": 0.5}}
    settings = {"estimator": OutputError(priors={"a": (0.5, 0.001)}), "execution": HERE}
    with pytest.warns(DataWarning) as caught:
        found = compare_bounds(Mixture(), RECORDS[:1], cases=cases, **settings)
    ((free,), held) = found["free"].warnings, found["held"].warnings
    assert held == ()
    (said,) = (str(each.message) for each in caught)
    assert said.startswith(f"cases 'free', 'tie': {free}")
    assert f"\n\n- {said}" in found.to_markdown()
    assert free.startswith("the records contradict the prior a = 0.5 ± 0.001")


@pytest.mark.parametrize(
    ("one", "other", "alike"),
    [
        ("the estimate -3.348 lies 11.2 deviations", "the estimate 5e-3 lies 9 deviations", True),
        ("contradicts (errors: Lr 2.8, Np 2.1), by 30", "contradicts (errors: Nr 4), by 2", True),
        ("record 'm 1' turns 57 times", "record 'm 2' turns 57 times", False),
        (
            "all parameters' errors of m1 believe 'x'",
            "all parameters' errors of m2 believe 'x'",
            False,
        ),
        ("response 1 contradicts 3 others", "response 2 contradicts 3 others", False),
        ("residuals of p follow", "residuals of q follow", False),
    ],
)
def test_texts_are_of_one_kind_where_figures_alone_differ(one, other, alike):
    assert (kind(one) == kind(other)) == alike


def test_each_text_stands_once_with_those_it_is_of():
    said = {"a": ["off by 1", "odd", "off by 7"], "b": ["off by 2", "odd"], "c": ["odd"]}
    assert sentences(said) == [
        "cases 'a', 'b': off by 1 (figures of case 'a'; those of others differ)",
        "odd",
        "case 'a': off by 7",
    ]
    assert sentences({"a": [], "b": []}) == []
    assert told(lambda: tell({"a": ["odd", "even"]}, known=["odd"])) == ["even"]


@pytest.mark.parametrize(("saying", "draws"), [(1, 3), (9, 100), (10, 100), (2, 20)])
def test_what_a_tenth_of_draws_says_is_told_with_their_number(saying, draws):
    said = [["off by 3"]] * saying + [[]] * (draws - saying)
    expected = [] if saying < max(2, draws / 10) else [f"{saying} of {draws} draws: off by 3"]
    assert told(lambda: tell_of_draws(said)) == expected
    assert told(lambda: tell_of_draws(said, ["off by 4"])) == []


def test_what_is_heard_is_told_all_the_same():
    def twice():
        with heard() as known:
            warn("odd")
        assert known == ["odd"]
        with heard() as known:
            warn("even")
            raise KeyError

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with pytest.raises(KeyError):
            twice()
    assert [str(each.message) for each in caught] == ["odd", "even"]
