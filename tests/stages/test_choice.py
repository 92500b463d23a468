"""The choice of the last step by prediction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from truths.closed_roll import TRUTH, campaign, off

from casid import (
    ConvergenceError,
    DataWarning,
    Match,
    OutputError,
    Pbsid,
    SpectralAnalysis,
    frequency_response,
    identify,
    output_error,
)
from casid.bounds.manoeuvres import StructureComparison
from casid.stages.choice import (
    CHOICE,
    CHOSEN,
    WORDS,
    Choosing,
    LastStep,
    StepChoice,
    chosen,
    groups,
    last_steps,
    possible,
)
from casid.stages.stage import Task
from casid.values import decode, encode

RECORDS = tuple(campaign(1, 4))
OMEGA = np.geomspace(2.5, 9.0, 8)
SHORT = tuple(each.decimate(2) for each in RECORDS[:3])
OWN = {
    "output_error": OutputError(interval=2.0),
    "frequency": SpectralAnalysis(omega=np.geomspace(2.5, 9.0, 6)),
    "pbsid": Pbsid(order=3),
}


def task(**roles):
    return Task(model=off(share=0.1), roles={"identification": RECORDS, **roles}, settings=OWN)


def test_candidates_are_those_that_the_records_allow():
    assert list(last_steps(Choosing(), task())) == ["frequency", "time", "quadratic"]
    both = last_steps(Choosing(), task(refinement=SHORT, frequency=RECORDS[3:]))
    assert list(both) == ["joint", "frequency", "time", "short", "quadratic"]
    names = tuple(each.name for each in SHORT)
    assert both["joint"].histories == both["short"].histories == names
    assert both["joint"].decimate == 2
    assert both["frequency"].estimator.domain == "frequency"
    square = np.sign(np.sin(np.arange(max(each.N for each in RECORDS)) / 11.1))[:, None]
    # Every second step is with a sample that would be left out.
    stepped = tuple(replace(each, u=0 * each.u + square[: each.N]) for each in RECORDS)
    every = last_steps(Choosing(), task(identification=stepped, refinement=SHORT))
    assert {each.decimate for each in every.values()} == {1}
    assert both["quadratic"].black_box.order == 3
    found = Pbsid(order=3).fit(RECORDS)
    known = last_steps(Choosing(), replace(task(), results={"pbsid": found}))
    assert known["quadratic"].black_box.pole == found.pole
    few = Choosing(candidates=("time", "joint"))
    assert list(last_steps(few, task())) == ["time"]
    with pytest.raises(ValueError, match=r"candidates = \['best'\], expected of joint"):
        Choosing(candidates=("best",))


def test_manoeuvres_are_dealt_out_to_at_most_four_groups():
    assert groups(("a", "b", "c")) == [("a",), ("b",), ("c",)]
    assert groups(tuple("abcdef")) == groups(tuple("abcdef"), RECORDS, TRUTH.inputs)
    assert groups(tuple("abcdef")) == [("a", "e"), ("b", "f"), ("c",), ("d",)]


def comparison(errors):
    errors = np.exp(np.array(errors, dtype=float))[:, :, None] * np.ones((1, 1, 3))
    n = len(errors)
    return StructureComparison(
        names=tuple("abc"[:n]), manoeuvres=("x", "y", "z"), outputs=TRUTH.outputs, errors=errors,
        parameters=(7,) * n, aicc=np.zeros(n), fits=tuple("ABC"[:n]), reasons={"c, all": "no"},
        noise=np.zeros(3),
    )  # fmt: skip


def test_the_one_with_the_smallest_errors_is_chosen_the_first_of_equals():
    clear = chosen(comparison([[0.3, 0.3, 0.2], [0.0, 0.1, 0.0], [np.nan] * 3]))
    assert (clear.chosen, clear.fit) == ("b", "B")
    assert clear.headline().startswith("Last step: b, chosen by errors of predicting x, y, z")
    assert np.isinf(clear.excess[2])
    assert clear.headline().endswith(
        "; errors of the others, relative to its own: a +26 ± 4 %, c failed"
    )
    close = chosen(comparison([[0.03, -0.02, 0.01], [0.0, 0.0, 0.0]]))
    assert (close.chosen, close.fit) == ("a", "A")
    assert close.excess[1] < 0
    assert "b equal within errors (-1 ± " in close.headline()
    alike = chosen(comparison([[0.001, -0.002, 0.001], [0.0, 0.0, 0.0005]]))
    assert "at least" not in alike.headline()
    assert chosen(replace(comparison([[0.1] * 3, [0.0] * 3]), noise=np.full(3, 0.99))).hidden
    least = ", at least: errors are below the noise"
    assert replace(alike, hidden=True).headline() == alike.headline() + least
    assert "b equal within errors (+0.0 ± 0.1 %)" in alike.headline()  # no errors of nothing
    with pytest.raises(ConvergenceError, match=r"no last step could be estimated:\na, all: no$"):
        chosen(replace(comparison([[np.nan] * 3] * 2), reasons={"a, all": "no"}))


def test_of_the_steps_the_chosen_one_tells_its_doubts(monkeypatch, recwarn):
    found = comparison([[0.3, 0.3, 0.2], [0.0, 0.1, 0.0], [np.nan] * 3])
    found = replace(found, warnings={"a": ("a loses",), "b": ("a prior is off",)})
    monkeypatch.setattr("casid.stages.choice.compared", lambda *_: found)
    with pytest.warns(DataWarning, match="^a prior is off$"):
        assert CHOICE.run(Choosing(), task()).chosen == "b"
    assert not recwarn


@pytest.mark.slow
def test_it_is_estimated_chosen_and_kept():
    work = replace(task(refinement=SHORT[:2]), results={"quadratic": _Fit(TRUTH)})
    settings = Choosing(candidates=("frequency", "time"))
    found = CHOICE.run(settings, work)
    assert found.manoeuvres == ("record 0", "record 1")
    assert found.names == ("frequency", "time")
    assert found.excess[found.names.index(found.chosen)] == 0
    assert (found.excess >= -found.error).all()
    assert found.fit.model.Lp == pytest.approx(TRUTH.Lp, rel=0.05)
    again = decode(encode(found), (type(TRUTH),))
    assert isinstance(again, StepChoice)
    assert again.fit.model == found.fit.model
    assert CHOSEN.run(None, replace(work, results={"choice": found})) is found.fit
    (shown,) = CHOICE.show(found, None)
    assert found.chosen in shown.lead


def test_a_step_takes_its_own_manoeuvres_as_time_histories():
    names = ("record 0", "record 2")
    found = LastStep(estimator=OutputError(), histories=names, decimate=2).fit(TRUTH, RECORDS)
    direct = output_error(TRUTH, [RECORDS[0].decimate(2), RECORDS[2].decimate(2)])
    assert found.model == direct.model


@pytest.mark.second
def test_the_others_enter_as_a_response():
    step = LastStep(
        estimator=OutputError(), histories=("record 0",), responses=SpectralAnalysis(omega=OMEGA)
    )
    measured = frequency_response(RECORDS[1:], omega=OMEGA)
    direct = output_error(TRUTH, RECORDS[:1], responses=measured)
    assert step.fit(TRUTH, RECORDS).model == direct.model
    alone = step.fit(TRUTH, RECORDS[:1])  # nothing is left for a response
    assert alone.model == output_error(TRUTH, RECORDS[:1]).model


@pytest.mark.second
def test_a_match_is_to_a_black_box_of_what_is_there():
    step = LastStep(estimator=Match(norm="quadratic"), black_box=Pbsid(order=3, past=20, future=10))
    found = step.fit(TRUTH, RECORDS[:2])
    assert found["Lp"].value == pytest.approx(TRUTH.Lp, rel=0.2)


@pytest.mark.campaign
def test_a_match_leaves_frequencies_to_which_fewer_manoeuvres_do_not_reach():
    settings = Pbsid(order=3, past=20, future=10)
    low, high = settings.fit(RECORDS[:2]).band
    inside = np.geomspace(low, high, 10)[1:-1]
    wide, own = (
        LastStep(estimator=Match(norm="quadratic", omega=omega), black_box=settings)
        for omega in (np.array([low / 2, *inside, 2 * high]), inside)
    )
    assert wide.fit(TRUTH, RECORDS[:2]).model == own.fit(TRUTH, RECORDS[:2]).model


class _Fit:
    def __init__(self, model):
        self.model = model


def test_two_manoeuvres_are_refused_before_anything_is_estimated():
    CHOICE.check(Choosing(), task())
    few = replace(task(), roles={"identification": RECORDS[:2]})
    with pytest.raises(ValueError, match="takes 3 records of identification or more, here are 2"):
        CHOICE.check(Choosing(), few)


def moved(*axes):
    """Records of which each moves the axes named alone."""
    return tuple(
        replace(each, u=each.u * [axis in own for axis in ("lat", "ped")], name=f"m{k}")
        for k, (own, each) in enumerate(zip(axes, [*RECORDS, *RECORDS], strict=False))
    )


LAT, PED = ("lat",), ("ped",)


def test_what_alone_moves_an_axis_is_in_no_group():
    once, twice = moved(LAT, LAT, PED), moved(PED, LAT, LAT, LAT, PED)
    assert groups(("m0", "m1", "m2"), once, TRUTH.inputs) == [("m0",), ("m1",)]
    names = tuple(each.name for each in twice)  # the fifth would join the other with ped
    assert groups(names, twice, TRUTH.inputs) == [("m0",), ("m1", "m4"), ("m2",), ("m3",)]


def test_too_few_manoeuvres_that_others_replace_are_refused_before_any_stage():
    CHOICE.examine(Choosing(), task())
    records = moved(LAT, PED, LAT)
    one = task(identification=records, refinement=records[:2])
    with pytest.raises(ValueError, match=r"\(m0, m1\): without m1 nothing moves ped; fly each"):
        CHOICE.examine(Choosing(), one)
    CHOICE.examine(Choosing(), replace(one, fixed=("Lped",)))
    with pytest.raises(ValueError, match=r"\[choice\] leaves manoeuvres out"):
        identify(off(share=0.1), records, refinement=records[:2], settings={"choice": Choosing()})


def test_a_candidate_by_name_that_the_records_do_not_allow_is_refused():
    files = {
        role: tuple(Path(f"{each.name}.csv") for each in own)
        for role, own in task(refinement=SHORT, frequency=RECORDS[3:]).roles.items()
    }
    assert possible(replace(task(), roles=files)) == list(WORDS)  # before they are read
    del files["refinement"]
    assert possible(replace(task(), roles=files)) == ["frequency", "time", "quadratic"]
    whole = task(refinement=SHORT, frequency=RECORDS[3:])
    for asked, without, needs in (
        (("short", "quadratic"), task(), "'short' takes records of refinement that are some"),
        (("joint", "time"), task(refinement=SHORT), "'joint' takes records of frequency"),
    ):
        CHOICE.check(Choosing(candidates=asked), whole)
        with pytest.raises(ValueError, match=needs):
            CHOICE.check(Choosing(candidates=asked), without)
