"""What a design says and writes."""

from dataclasses import replace

import numpy as np
import pytest

from casid import Design
from casid.design.plan import Alternative
from casid.values import decode, encode


@pytest.fixture
def design():
    t = 0.1 * np.arange(30)
    wave = np.sin(t)[:, None]
    errors = np.array([0.5, 0.1])
    C = np.outer(errors, errors) * [[1.0, 0.95], [0.95, 1.0]]
    return Design(
        kind="steps", inputs=("lat",), outputs=("p",), t=t, r=wave, u=wave,
        y=np.cos(t)[:, None], names=("Lp", "Llat"), covariance=C,
        values=np.array([-2.0, 9.0]), before=np.array([np.inf, 0.2]),
        used={"lat": 0.8}, used_at_worst={"lat": 1.0},
        instead=1260.0,
        alternatives=(
            Alternative(name="3-2-1-1", r=wave / 2, std_errors=np.array([1.0, 0.4])),
            Alternative(name="steps", r=wave, std_errors=errors),
        ),
    )  # fmt: skip


def test_it_says_what_it_buys(design):
    assert "0.354 times those of 3-2-1-1 (geometric mean), 0.5 at worst" in repr(design)
    assert "at worst (Lp), each with what is known before; " in design.headline()
    assert "known before" not in replace(design, before=np.full(2, np.inf)).headline()
    worse = Alternative(name="steps", r=design.r, std_errors=np.array([1.022, 0.1]))
    other = replace(design, alternatives=(design.alternatives[0], worse))
    assert "1.02 at worst (Lp)" in other.headline()  # as the table has it, not 1
    assert "; 2.9 s of flight instead of 21 minutes" in repr(design)
    assert "| steps | 0.354 | 0.500 | Lp |" in design.comparison()
    assert "| Llat | 9 | 0.2 | 0.4 | 0.1 |" in design.to_markdown()
    assert "| lat | 80 % | 100 % |" in design.shares()
    assert design.correlated() == (("Lp", "Llat", pytest.approx(0.95)),)


def test_it_says_for_how_many_aircraft_its_limits_do_not_hold(design):
    assert "held" not in design.headline() + design.shares()
    some = replace(design, plausible=48, unheld=16, r=2.0 * design.r)
    for said in (some.headline(), some.shares(), some.to_px4({"lat": ("y", 500.0)})):
        assert "16 of 48 plausible aircraft are not held by the feedback given: limits" in said


def test_without_feedback_it_does_not_speak_of_any(design):
    alone = replace(design, plausible=48, unheld=16).warning()
    assert "16 of 48 plausible aircraft are too unstable to be flown without feedback:" in alone
    assert "held by the feedback" not in alone


def test_what_is_no_better_than_the_3211_is_not_recommended(design):
    errors = design.alternatives[0].std_errors
    steps = Alternative(name="steps", r=design.r, std_errors=errors)
    same = replace(
        design, covariance=np.diag(errors**2), instead=2.9,
        alternatives=(design.alternatives[0], steps),
    )  # fmt: skip
    assert '; no better than the 3-2-1-1: fly that, to_csv("3-2-1-1"), or' in same.headline()
    assert (same.gains, design.gains) == (False, True)
    assert "of flight" not in same.headline()
    assert "no better" not in design.headline()
    assert "instead" not in replace(design, instead=1.0).headline()  # no gain in time
    assert "instead" not in replace(design, instead=2.901).headline()  # the same as they are told


def test_what_matters_is_what_is_compared(design):
    some = replace(design, matter=("Llat",))
    assert "errors of Llat 0.25 times those of 3-2-1-1 (geometric mean), 0.25 at worst (Llat)" in (
        some.headline()
    )
    assert "| steps | 0.250 | 0.250 | Llat |" in some.comparison()


def test_it_says_which_aircraft_its_limits_are_kept_with(design):
    assert "nine in ten" not in design.shares()  # no other was drawn
    guess = replace(design, plausible=48, spread=0.2, before=np.full(2, np.inf))
    assert (
        "aircraft whose values are scattered, lognormally, by 20% about the values given."
        in guess.shares()
    )
    assert "say so (spread, or an ensemble)" in guess.shares()
    assert "held" not in guess.shares()
    some = replace(guess, unheld=16)  # 0.9 of two thirds
    assert (
        "the values given and that stay under control, 60% of all with such values."
        in some.shares()
    )
    fitted = replace(design, plausible=48, spread=0.2)
    assert (
        "scattered, lognormally, by 20% beside the errors of the fit about the" in fitted.shares()
    )


def test_of_a_nonlinear_structure_it_says_in_which_motion_limits_are_kept(design):
    flown = replace(design, plausible=96, unheld=8, untrimmed=4, trim={"p": 0.0})
    assert (
        "and that have a trim and stay under control, 79% of all" in flown.margin()
    )  # 0.9 × 84/96
    assert "values. They are flown in the nonlinear structure, each from a trim" in flown.margin()
    assert "4 of 96 plausible aircraft have no trim near that of the design" in flown.headline()
    unknown = replace(design, plausible=96, linearised=True)
    assert unknown.margin().startswith("Limits are kept, in small motions about the trim, by nine")
    assert "nonlinear" not in unknown.margin() + replace(design, plausible=96).margin()


def test_it_says_how_far_a_card_goes_that_feedback_adds_to(design):
    assert "card" not in design.shares()
    held = replace(design, r=2.0 * design.u)
    assert "by at most lat 2 instead of 1." in held.shares()
    assert "instead" not in replace(design, r=1.0001 * design.u).shares()  # the same three digits


def test_it_says_what_noise_that_is_heard_takes_beyond_limits(design):
    assert (design.noise(), design.exceeded()) == ("", ())
    heard = replace(
        design, plausible=48, used={"lat": 0.8, "lat rate": 0.7}, used_by_noise={"lat rate": 0.4},
        used_at_worst={"lat": 1.0, "lat rate": 0.9}, used_with_noise={"lat rate": 0.95},
    )  # fmt: skip
    assert "| lat rate | 70 % | 90 % | 40 % | 95 % |" in heard.shares()
    assert "| lat | 80 % | 100 % |  |  |" in heard.shares()
    assert "Without noise limits are kept by nine in ten aircraft" in heard.shares()
    assert heard.exceeded() == ()
    assert replace(heard, used_with_noise={"lat rate": 1.004}).exceeded() == ()  # reads 100 %
    together = replace(heard, used_with_noise={"lat rate": 1.3})
    assert "lat rate 130% (alone 40%). Filter the feedback signals, fly a" in together.shares()
    alone = replace(together, used_by_noise={"lat rate": 1.1}).exceeded()
    assert "lat rate 130% (alone 110%). No card avoids that: filter" in alone[0]
    assert len(alone) == 1


def test_what_is_not_told_is_left_out_and_what_no_3211_tells_is_said(design):
    some = replace(design, untold=("Lp",), instead=np.inf)
    assert "0.25 times those of 3-2-1-1 (geometric mean), 0.25 at worst (Llat)" in some.headline()
    assert "for what no time of 3-2-1-1 identifies; without Lp, which no input" in some.headline()
    assert "| steps | 0.250 | 0.250 | Llat |" in some.comparison()
    assert "| Lp | -2 | inf | not told | not told |" in some.to_markdown()
    assert "not told" not in design.to_markdown()


def test_it_is_kept_and_read_back(design):
    again = decode(encode(design))
    np.testing.assert_array_equal(again.r, design.r)
    assert again.alternatives[1].name == "steps"


def test_the_card_is_the_sequence(design):
    lines = design.to_csv().splitlines()
    assert lines[0] == "t,lat"
    assert len(lines) == 31
    half = np.loadtxt(design.to_csv("3-2-1-1").splitlines(), delimiter=",", skiprows=1)
    np.testing.assert_allclose(half, np.column_stack([design.t, design.r / 2]), atol=1e-9)
    with pytest.raises(ValueError, match="the alternatives have no 'doublet'"):
        design.to_csv("doublet")
    assert design.record().N == 30
