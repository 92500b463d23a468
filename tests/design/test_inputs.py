"""Designs end to end on a small structure."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from casid import (
    DesignSettings,
    Limits,
    Model,
    NonlinearModel,
    Record,
    Trim,
    design_inputs,
    output_error,
    parameter,
)
from casid.design.loop import Loop, UnheldError
from casid.excitations import excitation
from models.lateral_directional import LateralDirectional
from models.short_period import ShortPeriod

MODEL = ShortPeriod()
STICK = MODEL.inputs[0]
NOISE = dict.fromkeys(MODEL.outputs, 0.01)
QUICK = {"dt": 0.05, "iterations": 20, "rest": 1.0, "draws": 4}


def designed(limits=None, duration=10.0, noise=NOISE, **options):
    limits = limits or Limits(sticks={STICK: 0.1})
    settings = DesignSettings(**{**QUICK, **options})
    return design_inputs(MODEL, limits, duration, noise=noise, settings=settings)


@pytest.fixture(scope="module")
def design():
    limits = Limits(sticks={STICK: 0.1}, rates={STICK: 1.0}, responses={MODEL.outputs[-1]: 0.05})
    return designed(limits)


def test_a_design_beats_what_is_usually_flown_within_the_same_limits(design):
    ratio = design.std_errors / design.alternatives[0].std_errors
    assert np.exp(np.log(ratio).mean()) < 0.8
    assert max(design.used.values()) <= 1 + 1e-6
    rates = np.abs(np.diff(design.r[:, 0])) / np.diff(design.t)
    assert rates.max() <= 1.0 + 1e-6
    assert np.abs(design.y[:, -1]).max() <= 0.05 + 1e-9


@pytest.mark.second
def test_3211_that_fly_as_long_as_it_says_tell_as_much():
    usual = {"unit": 1.0, "band": (0.5, 8.0), "draws": 0, "method": "steps"}
    made = designed(duration=40.0, **usual)
    longer = designed(duration=made.instead, **usual).alternatives[0].std_errors
    # one of six more or less is 8 % in standard errors
    assert np.exp(np.log(longer / made.std_errors).mean()) == pytest.approx(1.0, abs=0.08)


@pytest.mark.second
def test_3211_of_the_best_unit_are_no_worse_than_those_of_any_other():
    def errors(**unit):
        made = designed(duration=30.0, draws=0, method="steps", **unit)
        return np.log(made.alternatives[0].std_errors).mean()

    assert errors() <= min(errors(unit=unit) for unit in (0.3, 0.6, 1.2, 2.4)) + 0.1


def test_limits_hold_in_the_simulation_of_the_model(design):
    y = MODEL.system().simulate(design.t, design.u)
    np.testing.assert_allclose(y, design.y, atol=0.01 * np.abs(design.y).max())


@pytest.mark.second
def test_a_multisine_begins_and_ends_in_trim_though_its_grid_is_not_the_cards():
    roll = LateralDirectional(U0=41.0)
    limits = Limits(sticks=dict.fromkeys(roll.inputs, 0.05))
    noise = dict.fromkeys(roll.outputs, 0.01)
    settings = DesignSettings(**{**QUICK, "dt": 0.015}, method="multisine", band=(0.6, 6.0))
    made = design_inputs(roll, limits, 31.0, noise=noise, settings=settings)
    still = made.t < 0.95  # the samples of the optimisation are 0.04 s apart
    assert not np.any(made.r[still])
    assert np.all(made.r[-1] == 0.0)
    slow = 1.5 * 0.05 / (np.pi / 6.0)  # no faster than the taper and the waves together
    assert np.abs(np.diff(made.r, axis=0)).max() / 0.015 <= slow + 0.05 * 6.0
    assert 0 < made.overlap < 0.05
    assert np.abs(made.r).max() == pytest.approx(0.05, rel=1e-3)


@pytest.mark.second
def test_parameters_that_matter_are_told_better_than_when_all_count():
    name = MODEL.parameter_names()[0]
    k = designed().names.index(name)
    assert designed(matter=(name,)).std_errors[k] <= 1.02 * designed().std_errors[k]


@pytest.mark.second
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"band": (0.5, 90.0)}, "above the Nyquist frequency 62.83"),
        ({"duration": 1.5}, "fly longer"),
        ({"duration": np.nan}, "duration = nan, expected"),
        ({"duration": -3.0}, "duration = -3 s"),
        ({"duration": 1e5}, "2e\\+06 samples .* design 5000 s at most"),
        ({"step": 20.0}, "step = 20 s"),
        ({"step": 0.5, "rest": 12.0}, "fly longer"),
        (
            {"limits": Limits(sticks={STICK: 0.1}, rates={STICK: 1e-7})},
            "takes 2e\\+06 s .* lower the limit of the stick, to 2.25e-07",
        ),
        ({"band": (2.2, 2.3), "method": "multisine"}, "0 harmonics .* widen the band or fly"),
        ({"band": (0.0, 2.0)}, "0 < lowest < highest"),
        ({"unit": -1.0}, "unit = -1 s"),
        (
            {"unit": 1.2},
            "unit = 1.2 s: 10 s have no room .* 1 input .*: use 1.16 s at most, or leave",
        ),
        ({"rest": -1.0}, "rest = -1: expected"),
        ({"draws": -1}, "draws = -1: expected"),
        ({"iterations": -3}, "iterations = -3: expected"),
        ({"spread": 20.0}, "spread = 20: expected a finite number, 0 or more, 1 at most"),
        ({"draws": 2000}, "draws = 2000: .*, 1000 at most"),
        ({"matter": ("Xx",)}, "matter: no free parameter is called 'Xx'"),
        ({"limits": Limits(sticks={"nose": 0.1})}, "limits name 'nose'"),
        ({"noise": NOISE | {"Q": 0.1}}, "noise names 'Q'; did you mean 'q'"),
        ({"noise": NOISE | {"q": np.inf}}, "output 'q' has inf; give"),
        (
            {"limits": Limits(sticks={STICK: 0.1}, responses={"q": 1e-9})},
            "limits are too tight: within that of 'q' .* times its size: widen it",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused_with_a_remedy(change, words):
    with pytest.raises(ValueError, match=words):
        designed(**change)


@pytest.mark.second
def test_a_delay_alone_can_be_designed_for():
    others = tuple(name for name in MODEL.parameter_names() if name != "tau_lon")
    assert designed(fixed=others).names == ("tau_lon",)


@pytest.mark.second
def test_what_matters_is_what_a_design_tells_of():
    made = designed(matter=("tau_lon",))
    k = made.names.index("tau_lon")
    ratio = pytest.approx(made.std_errors[k] / made.alternatives[0].std_errors[k])
    row = next(row for row in made.ratios() if row[0] == made.kind)
    assert row == (made.kind, ratio, ratio, "tau_lon")
    assert "standard errors of tau_lon" in made.headline()
    # information grows with the time less its rest, of one parameter that few others blur
    alone = 1.0 + 9.0 * float(row[1]) ** -2
    assert made.instead == pytest.approx(alone, rel=0.02)


def test_a_member_of_the_ensemble_is_named():
    limits, quick = Limits(sticks={STICK: 0.1}), DesignSettings(**QUICK, method="steps")

    def made(*others):
        design_inputs(MODEL, limits, 10.0, noise=NOISE, ensemble=others, settings=quick)

    with pytest.raises(ValueError, match=r"ensemble\[1\] is a Linear; expected .*, ShortPeriod"):
        made(replace(MODEL, Mq=-2.0), Linear())
    with pytest.raises(ValueError, match=r"ensemble\[0\]: Mq = -90 is outside its bounds"):
        made(replace(MODEL, Mq=-90.0))
    with pytest.raises(ValueError, match=r"ensemble\[1\]: Pendulum is not in balance"):
        swung(Pendulum(), ensemble=[Pendulum(c=0.6), Pendulum(k=2.3)])


def test_an_unstable_aircraft_needs_its_feedback_which_is_told_by_name():
    unstable = replace(MODEL, Mw=0.05)
    quick = DesignSettings(**QUICK, method="steps")
    limits = Limits(sticks={STICK: 0.1})
    with pytest.raises(ValueError, match=r"unstable .* more than e\^2: give the feedback that is"):
        design_inputs(unstable, limits, 10.0, noise=NOISE, settings=quick)
    held = {STICK: {"q": 0.5}}
    made = design_inputs(unstable, limits, 10.0, noise=NOISE, feedback=held, settings=quick)
    assert np.abs(made.u).max() <= 0.1 + 1e-9
    assert not np.allclose(made.u, made.r)


@pytest.mark.second
def test_aircraft_that_the_feedback_does_not_hold_are_counted_and_said():
    unstable, limits = replace(MODEL, Mw=0.08), Limits(sticks={STICK: 0.1})
    quick = DesignSettings(**{**QUICK, "draws": 12, "iterations": 4}, method="steps")

    def made(gain, settings=quick):
        held = {STICK: {"q": gain}}
        return design_inputs(unstable, limits, 12.0, noise=NOISE, feedback=held, settings=settings)

    weak = made(0.4)
    assert 0 < weak.unheld < weak.plausible == 36
    assert f"{weak.unheld} of 36 plausible aircraft are not held" in weak.headline()
    sure = replace(quick, spread=1e-6)
    assert "plausible" not in made(0.4, sure).headline()


def test_a_feedback_that_holds_no_plausible_aircraft_is_refused(monkeypatch):
    def loop(free, *rest, **grid):
        if free.model != MODEL:
            raise UnheldError
        return Loop(free, *rest, **grid)

    monkeypatch.setattr("casid.design.problem.Loop", loop)
    with pytest.raises(ValueError, match=r"none of 4 plausible aircraft.*20% off.*draws = 0"):
        designed(Limits(sticks={STICK: 0.1}, responses={"q": 0.1}))


@pytest.mark.slow
def test_a_flight_of_a_design_in_its_loop_holds_the_aircraft_not_the_controller():
    held = {STICK: {"q": 0.3}}
    settings = DesignSettings(**QUICK, method="steps")
    limits = Limits(sticks={STICK: 0.1})
    made = design_inputs(MODEL, limits, 60.0, noise=NOISE, feedback=held, settings=settings)
    flown = made.record().with_noise(NOISE, np.random.default_rng(2))
    share = excitation(flown)
    assert share.lower[share.within].min() > 0.5
    assert 0.0 < made.used_by_noise[STICK] < made.used_with_noise[STICK]


def test_noise_has_to_be_said():
    with pytest.raises(ValueError, match="noise of the outputs is not known"):
        design_inputs(MODEL, Limits(sticks={STICK: 0.1}), 10.0)


class Pendulum(NonlinearModel):
    """Hangs at θ = 0.8 rad under the moment that its reference names, if ``m0`` is right."""

    states, inputs, outputs = ("q", "theta"), ("m",), ("q", "theta")
    k: float = parameter(default=2.0, lower=0.1, upper=9.0, unit="1/s^2")
    c: float = parameter(default=0.5, lower=0.0, upper=9.0, unit="1/s")
    drift: float = parameter(default=0.0, lower=-1.0, upper=1.0, unit="rad/s^2")
    m0: float = 2.0 * np.sin(0.8)

    def reference(self):
        return {"theta": 0.8, "m": self.m0}

    def derivatives(self, x, u):
        return [u.m - self.k * ca.sin(x.theta) - self.c * x.q + self.drift, x.q]


class Linear(Model):
    states, inputs, outputs = ("q", "theta"), ("m",), ("q", "theta")
    k: float = parameter(default=2.0, lower=0.1, upper=9.0, unit="1/s^2")
    c: float = parameter(default=0.5, lower=0.0, upper=9.0, unit="1/s")
    theta0: float = 0.8

    def A(self):
        return [[-self.c, -self.k * ca.cos(self.theta0)], [1, 0]]

    def B(self):
        return [[1], [0]]


def swung(model, **options):
    noise, limits = {"q": 0.01, "theta": 0.01}, Limits(sticks={"m": 0.2}, responses={"theta": 0.2})
    settings = DesignSettings(**QUICK, method="steps")
    return design_inputs(model, limits, 10.0, noise=noise, settings=settings, **options)


@pytest.mark.second
def test_a_nonlinear_structure_is_designed_for_by_its_linearisation_at_the_trim():
    by_hand = swung(Linear())
    flown = swung(Pendulum())  # smaller for the aircraft that are drawn, if at all
    factor = np.abs(flown.r).max() / np.abs(by_hand.r).max()
    np.testing.assert_allclose(flown.r, factor * by_hand.r, rtol=1e-6, atol=1e-9)
    assert 0.9 < factor <= 1.0
    for theta in (0.8, 0.3):
        unknown = Trim(values={"theta": theta, "m": 2 * np.sin(theta)}, unknown=("m",))
        made = swung(Pendulum(), trim=unknown)  # stated by the linearisation
        there = swung(Linear(theta0=theta))
        np.testing.assert_allclose(made.covariance[:2, :2], there.covariance, rtol=1e-6)
        assert made.names == ("k", "c", "drift", "m_trim")
        assert made.untold == made.unfelt == ("drift", "m_trim")
        assert "does not depend on drift, m_trim" in made.warning()
        assert "| drift | 0 | inf | not told | not told |" in made.to_markdown()
    assert by_hand.warning() == ""


@pytest.mark.second
def test_what_is_known_from_before_only_keeps_its_error_where_the_linearisation_feels_nothing():
    flight = swung(Pendulum()).record()
    rng = np.random.default_rng(2)
    noisy = replace(flight, y=flight.y + 0.01 * rng.standard_normal(flight.y.shape))
    fit = output_error(Pendulum(), noisy)
    unknown = Trim(values={"theta": 0.3, "m": 2 * np.sin(0.3)}, unknown=("m",))
    limits = Limits(sticks={"m": 0.2}, responses={"theta": 0.2})
    settings = DesignSettings(**QUICK, method="steps")
    made = design_inputs(fit, limits, 10.0, settings=settings, trim=unknown)
    row = made.names.index("drift")
    assert "drift" in made.unfelt
    assert "drift" not in made.untold
    assert made.before[row] == pytest.approx(fit["drift"].std_error)
    assert 0 < made.std_errors[row] <= made.before[row]


def test_a_nonlinear_structure_has_to_be_in_balance_and_a_linear_one_has_its_trim():
    with pytest.raises(ValueError, match=r"not in balance.*d/dt q = -0\.435.*find_trim"):
        swung(Pendulum(m0=1.0))
    with pytest.raises(ValueError, match=r"at the trim given, where d/dt q = 0\.844.*find_trim"):
        swung(Pendulum(), trim=Trim(values={"theta": 0.3}))
    with pytest.raises(ValueError, match=r"at the trim given, where d/dt theta = 0\.1"):
        swung(Pendulum(), trim={"q": 0.1, "m": 2 * np.sin(0.8) + 0.05})
    with pytest.raises(ValueError, match=r"trim names 'Theta', which.* did you mean 'theta'"):
        swung(Pendulum(), trim={"Theta": 0.3})
    with pytest.raises(ValueError, match="the trim has theta = nan"):
        swung(Pendulum(), trim=Trim(values={"theta": np.nan}))
    others = swung(
        Pendulum(), ensemble=[Pendulum(k=2.1)], trim={"theta": 0.8}
    )  # its trim, not theirs
    assert others.names == ("k", "c", "drift")
    with pytest.raises(ValueError, match="about its own trim"):
        swung(Linear(), trim={"theta": 0.3})


@pytest.mark.second
def test_limits_hold_for_most_models_that_the_prior_allows():
    limits = Limits(sticks={STICK: 0.2}, responses={"q": 0.1})
    made = designed(limits, method="steps", spread=0.3, draws=32)
    rng, kept = np.random.default_rng(5), []
    for _ in range(40):
        values = MODEL.vector() * np.exp(0.3 * rng.standard_normal(len(MODEL.vector())))
        y = MODEL.with_vector(values).system().simulate(made.t, made.u)
        kept.append(np.abs(y[:, 1]).max() <= 0.1 * 1.01)
    # nine in ten are promised by 32 draws, whose own tenth is uncertain by 5 %
    assert np.mean(kept) >= 0.8


class Twins(Model):
    """Of whose dampings an output feels the sum."""

    states, inputs, outputs = ("p",), ("lat",), ("p",)
    Lp: float = parameter(default=-2.0, lower=-9.0, upper=0.0, unit="1/s")
    more: float = parameter(default=-1.0, lower=-9.0, upper=0.0, unit="1/s")
    Llat: float = parameter(default=5.0, lower=0.0, upper=60.0, unit="rad/s^2")

    def A(self):
        return [[self.Lp + self.more]]

    def B(self):
        return [[self.Llat]]


def rolled(**options):
    quick = DesignSettings(**QUICK, method="steps", **options)
    limits = Limits(sticks={"lat": 0.1})
    return design_inputs(Twins(), limits, 10.0, noise={"p": 0.01}, settings=quick)


def test_what_no_input_tells_apart_is_left_out_of_what_a_design_buys_and_named():
    made = rolled()
    assert made.untold == ("Lp", "more")
    assert "without Lp, more, which no input identifies" in made.headline()
    alone = made.std_errors[2] / made.alternatives[0].std_errors[2]
    assert made.ratios()[2] == ("steps", pytest.approx(alone), pytest.approx(alone), "Llat")
    apart = rolled(fixed=("more",))
    assert apart.untold == ()
    # the sum is told as well as one of which the other is known
    assert made.std_errors[2] == pytest.approx(apart.std_errors[1], rel=0.05)
    with pytest.raises(
        ValueError, match=r"identifies 'Lp' alone, only comb.* of Lp, more: fix one"
    ):
        rolled(matter=("Lp",))


def test_what_only_an_earlier_flight_tells_apart_is_not_to_be_fixed():
    t = 0.05 * np.arange(120)
    u = 0.1 * np.sign(np.sin(3 * t))[:, None]
    record = Record(t, u, Twins().system().simulate(t, u), ("lat",), ("p",))
    noisy = record.with_noise({"p": 0.01}, np.random.default_rng(0))
    one = output_error(Twins(), noisy, fixed=("more",))
    quick = DesignSettings(**QUICK, method="steps", fixed=())
    made = design_inputs(one, Limits(sticks={"lat": 0.1}), 10.0, settings=quick)
    assert made.untold == ()
    assert made.blind == ("distinguished only by prior knowledge: Lp, more",)
    least = Limits(sticks={"lat": 1e-9})
    with pytest.raises(ValueError, match="limits are too tight: within that of 'lat'"):
        design_inputs(one, least, 10.0, settings=quick)  # whatever is known before


def test_values_outside_their_bounds_are_refused_or_given_wider_ones():
    off, limits = replace(MODEL, Mq=-90.0), Limits(sticks={STICK: 0.1})

    def made(**options):
        quick = DesignSettings(**QUICK, method="steps", **options)
        return design_inputs(off, limits, 10.0, noise=NOISE, settings=quick)

    with pytest.raises(ValueError, match=r"Mq = -90 is outside its bounds, .*bounds=\{'Mq': \("):
        made()
    wide = made(bounds={"Mq": (-200.0, 0.0)})
    np.testing.assert_allclose(
        off.system().simulate(wide.t, wide.u), wide.y, atol=0.01 * np.abs(wide.y).max()
    )


def test_what_a_fit_held_fixed_stays_so_unless_asked_for(design):
    record = design.record().with_noise(NOISE, np.random.default_rng(0))
    fit = output_error(MODEL, record, fixed=("Mw", "Zw"))
    quick = DesignSettings(**QUICK, method="steps")

    def names(settings):
        return design_inputs(fit, Limits(sticks={STICK: 0.1}), 10.0, settings=settings).names

    assert set(MODEL.parameter_names()) - set(names(quick)) == {"Mw", "Zw"}
    assert "Mw" in names(replace(quick, fixed=("Zw",)))
    assert set(names(replace(quick, fixed=()))) == set(MODEL.parameter_names())


@pytest.mark.slow
def test_what_a_fit_knows_counts_and_its_residuals_are_the_noise(design):
    record = design.record().with_noise(NOISE, np.random.default_rng(0))
    fit = output_error(MODEL, record)
    quick = DesignSettings(**QUICK, method="steps")
    again = design_inputs(fit, Limits(sticks={STICK: 0.1}), 10.0, settings=quick)
    before = [fit[name].std_error for name in again.names]
    known = np.isfinite(before)
    np.testing.assert_allclose(again.before[known], np.array(before)[known], rtol=1e-3)
    assert np.all(again.std_errors[known] < again.before[known])
    alone = design_inputs(MODEL, Limits(sticks={STICK: 0.1}), 10.0, noise=NOISE, settings=quick)
    assert np.median(again.std_errors / alone.std_errors) < 1.05
    rows = [replace(row, cramer_rao=row.cramer_rao / 3) for row in fit.parameters]
    coloured = replace(fit, parameters=tuple(rows))  # errors three times what white noise makes
    worse = design_inputs(coloured, Limits(sticks={STICK: 0.1}), 10.0, settings=quick)
    assert np.median(worse.std_errors / again.std_errors) > 1.2
