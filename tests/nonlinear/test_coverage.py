"""Extrapolation is said: beyond the tables of a structure, beyond the records of its fit."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from casid import (
    DataWarning,
    NonlinearModel,
    Record,
    Scalar,
    Trim,
    output_error,
    parameter,
    simulate,
    spline,
    validate,
)
from casid.nonlinear.coverage import (
    airspeeds,
    joined_spans,
    leaves,
    reached,
    tabulated,
    warn_beyond,
)


class Pushed(NonlinearModel):
    """u' = push, q' = Mq(u) q + Mlon lon; damping tabulated over airspeed if it is asked for."""

    states, inputs, outputs = ("u", "q"), ("push", "lon"), ("u", "q")
    units = {"u": "m/s"}  # noqa: RUF012

    Mq: Scalar = parameter(default=-1.5, lower=-5.0, upper=0.0, unit="1/s")
    Mlon: Scalar = parameter(default=4.0, lower=0.0, upper=20.0, unit="rad/s^2")
    knots: tuple[float, ...] = (20.0, 30.0, 40.0)

    def derivatives(self, x, u):
        more = spline(x.u, self.knots, (0.0, 0.1, 0.3)) if self.knots else 0.0
        return [u.push, (self.Mq - more) * x.q + self.Mlon * u.lon]

    def reference(self):
        return {"u": 30.0}


def flown(start, push, model=None, seed=1):
    t = 0.1 * np.arange(120)
    u = np.column_stack([np.full(120, push), 0.1 * np.sign(np.sin(2 * t))])
    still = Record(t, u, np.zeros((120, 2)), Pushed.inputs, Pushed.outputs, "flown")
    return simulate(model or Pushed(), still, {"u": start}).with_noise(
        {"u": 0.1, "q": 0.01}, np.random.default_rng(seed)
    )


def test_tables_and_their_narrowest_span_are_found():
    class Two(Pushed):
        """With a second table over the same variable, one over another, one over a constant."""

        def derivatives(self, x, u):
            own = spline(x.u, (25.0, 50.0), (0.0, 1.0)) + spline(x.q * x.u, (-1.0, 1.0), (0.0, 1.0))
            push, q = Pushed.derivatives(self, x, u)
            return [push, q + own + spline(self.Mq, (0.0, 1.0), (0.0, 1.0))]

    assert tabulated(Two()) == {"u": (25.0, 40.0), "(u*q)": (-1.0, 1.0)} or tabulated(Two()) == {
        "u": (25.0, 40.0), "(q*u)": (-1.0, 1.0)
    }  # fmt: skip
    x = np.array([[21.0, 0.5], [35.0, -0.1]])
    assert [ends for _, ends in sorted(reached(Two(), x, np.zeros((2, 2))).items())] == [
        (-3.5, 10.5), (21.0, 35.0)
    ]  # fmt: skip


def test_tables_are_those_that_the_code_reads_by_now():
    ends = [20.0, 40.0]

    class Own(Pushed):
        def derivatives(self, x, u):
            return [u.push, spline(x.u, tuple(ends), (0.0, 1.0))]

    assert tabulated(Own()) == {"u": (20.0, 40.0)}
    ends[0] = 25.0
    assert tabulated(Own()) == {"u": (25.0, 40.0)}


def test_an_airspeed_without_tables_is_known_but_not_limited():
    bare = Pushed(knots=())
    assert tabulated(bare) == {}
    assert reached(bare, np.array([[20.0, 0.0], [25.0, 0.0]]), np.zeros((2, 2))) == {"u": (20, 25)}


def test_spans_are_joined():
    assert joined_spans([{"u": (1.0, 2.0)}, {}, {"u": (0.0, 1.5), "V": (3.0, 4.0)}]) == {
        "u": (0.0, 2.0), "V": (3.0, 4.0)
    }  # fmt: skip


@pytest.mark.parametrize("speed", [20.0, 39.0, 41.9])
def test_conditions_within_the_tables_or_about_their_end_are_taken_in_silence(speed):
    Pushed().at(Trim(values={"u": speed}))


def test_a_condition_beyond_the_tables_is_said_once_for_all():
    trims = [Trim(name=f"{u:g}", values={"u": u}) for u in (15.0, 30.0, 55.0)]
    with pytest.warns(DataWarning) as said:
        Pushed().at(*trims)
    (one,) = said
    words = r"Pushed, .*u runs from 15 to 55 m/s, where its tables cover 20 to 40.*fly there"
    assert re.search(words, str(one.message))


def test_unknown_trims_are_not_judged_by_their_start():
    Pushed().at(Trim(values={"u": 55.0}, unknown=("u", "push")))


def test_a_simulation_beyond_the_tables_is_said():
    with pytest.warns(DataWarning, match="'flown': u runs from 35 to 5"):
        flown(35.0, 1.5)


@pytest.fixture(scope="module")
def fit():
    return output_error(Pushed(knots=()), [flown(20.0, 0.8), flown(30.0, -0.2)], biases=False)


def test_a_fit_knows_what_its_records_covered(fit):
    low, high = fit.notes.covered["u"]
    assert low == pytest.approx(20.0, abs=0.2)
    assert high == pytest.approx(30.0, abs=0.5)


def test_what_a_fit_covered_is_stored(fit, tmp_path):
    fit.save(tmp_path / "fit.json")
    again = type(fit).load(tmp_path / "fit.json", model=Pushed)
    assert again.notes.covered == fit.notes.covered


def test_validation_beyond_the_records_of_a_fit_is_said_once(fit):
    validate({"fit": fit}, flown(21.0, 0.5, seed=3), horizon=np.inf)
    fast = [flown(40.0, 0.5, Pushed(knots=())), flown(45.0, 0.5, Pushed(knots=()))]
    with pytest.warns(DataWarning) as said:
        validate({"fit": fit}, fast, horizon=np.inf)
    (one,) = said
    told = r"'fit': u runs from (\S+) to 50.* where the records of the fit"
    begun = re.search(told, str(one.message))
    assert float(begun[1]) == pytest.approx(40.0, abs=0.2)


def test_an_airspeed_that_only_tables_cover_is_said():
    fit = output_error(Pushed(), [flown(20.0, 0.8), flown(30.0, -0.2)], biases=False)
    with pytest.warns(DataWarning, match=r"u runs from 37.* where the records of the fit cover"):
        validate({"fit": fit}, flown(38.0, 0.1), horizon=np.inf)


class Lifting(NonlinearModel):
    """A lift curve in a table of the angle of attack."""

    states, inputs, outputs = ("alpha",), ("el",), ("alpha",)
    slope: Scalar = parameter(default=1.0, unit="1/s")

    def derivatives(self, x, u):
        return [u.el - self.slope * spline(x.alpha, [-0.1, 0.0, 0.1], [-0.1, 0.0, 0.2])]


@pytest.mark.parametrize(
    ("flown", "by"),
    [
        ((-0.03, 0.03), "its tables cover -0.1 to 0.1"),
        ((-0.2, 0.3), "the records of the fit cover -0.2 to 0.3"),
        ((-0.2, 0.03), "its tables and the records of the fit cover -0.2 to 0.1"),
    ],
)
def test_what_covers_is_named(flown, by):
    with pytest.warns(DataWarning, match=f"where {by}"):
        warn_beyond(Lifting(), "here", {"alpha": (-0.5, 0.5)}, {"alpha": flown})


@pytest.mark.second
def test_records_widen_what_tables_cover():
    wide = (10.0, 30.0, 60.0)
    records = [flown(s, 1.0, Pushed(knots=wide), seed=s) for s in (38, 44)]
    with pytest.warns(DataWarning, match="along the records of the fit: u runs from 3"):
        fit = output_error(Pushed(), records, biases=False)
    validate({"fit": fit}, flown(50.0, 0.2, Pushed(knots=wide)), horizon=np.inf)  # seen: silence


def test_theils_coefficient_of_total_values_is_that_of_deviations():
    total = flown(30.0, 0.02, Pushed(knots=()), seed=4)
    off = Pushed(Mq=-3.0, Mlon=3.0, knots=())
    found = [
        validate({"off": off}, record, horizon=np.inf).theil["off"]
        for record in (total, total.detrend("mean"))
    ]
    np.testing.assert_allclose(*found, rtol=1e-6)
    assert found[0][0, 0] > 0.1  # u moves by 0.24 m/s about 30, with noise of 0.1


def test_a_span_may_be_left_by_a_share_of_its_size():
    assert not leaves((54.5, 57.0), (54.7, 54.9))
    assert leaves((50.0, 54.8), (54.7, 54.9))
    assert leaves((54.8, 58.0), (54.7, 54.9))


def test_a_span_may_be_left_by_a_tenth_of_what_is_covered():
    assert not leaves((-10.0, 109.0), (0.0, 100.0))
    assert leaves((0.0, 111.0), (0.0, 100.0))


@pytest.mark.parametrize(
    ("states", "inputs", "units", "expected"),
    [
        (("u", "w"), ("lon",), {}, ("u",)),
        (("V", "w"), ("u",), {}, ("V",)),  # this u is a stick, whatever its name
        (("V", "w"), ("u",), {"u": "-"}, ("V",)),
        (("w",), ("V",), {"V": "m/s"}, ("V",)),
        (("w",), ("V",), {}, ()),
    ],
)
def test_airspeeds_are_states_or_inputs_of_that_unit(states, inputs, units, expected):
    model = SimpleNamespace(states=states, inputs=inputs, units=units)
    assert airspeeds(model, (*states, *inputs, "V_wind")) == expected
    assert airspeeds(model, ()) == ()
