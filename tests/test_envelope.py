"""Entries, errors and poles over speed, against formulas of a structure small enough for them."""

from dataclasses import replace
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from truths.twofold import Twofold

from casid import (
    DataWarning,
    Model,
    ModelError,
    NonlinearModel,
    Record,
    Scalar,
    Trim,
    envelope,
    match,
    output_error,
    parameter,
    simulate,
)
from casid.envelope import _apart
from casid.report.content import LEADING
from casid.stages.conditions import _show

mpl.use("Agg")


class Faster(NonlinearModel):
    """q' = (Mq + Mq_V (u - 30) / 10) q + Mlon u lon; u obeys its own input."""

    states, inputs, outputs = ("u", "q"), ("lon", "push"), ("u", "q")

    Mq: Scalar = parameter(default=-1.0, lower=-5.0, upper=0.0, unit="1/s")
    Mq_V: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="1/s")
    Mlon: Scalar = parameter(default=0.2, lower=0.0, upper=2.0, unit="rad/(m s)")

    def derivatives(self, x, u):
        damping = self.Mq + self.Mq_V * (x.u - 30.0) / 10.0
        return [u.push, damping * x.q + self.Mlon * x.u * u.lon]

    def reference(self):
        return {"u": 30.0}


class Local(Model):
    """The same at one speed."""

    states, inputs, outputs = ("u", "q"), ("lon", "push"), ("u", "q")

    Mq: Scalar = parameter(default=-1.0, lower=-5.0, upper=0.0, unit="1/s")
    M: Scalar = parameter(default=6.0, lower=0.0, upper=60.0, unit="rad/s^2")

    def A(self):
        return [[0, 0], [0, self.Mq]]

    def B(self):
        return [[0, 1], [self.M, 0]]


TRUTH = Faster(Mq=-1.5, Mq_V=-0.4, Mlon=0.3)
PAIRS = [("q", "q"), ("q", "lon")]


def flown(speed):
    t = 0.1 * np.arange(100)
    u = np.column_stack([0.1 * np.sign(np.sin(2 * t)), 0 * t])
    still = Record(t, u, np.zeros((100, 2)), Faster.inputs, Faster.outputs, f"{speed}")
    noise, rng = {"u": 0.1, "q": 0.02}, np.random.default_rng(int(speed))
    return simulate(TRUTH, still, {"u": speed}).with_noise(noise, rng)


@pytest.fixture(scope="module")
def fit():
    return output_error(Faster(), [flown(20.0), flown(40.0)], biases=False)


def at(*speeds):
    return [Trim(name=f"{V}", values={"u": V}) for V in speeds]


def test_entries_and_their_errors_are_those_of_the_formula(fit):
    found = envelope(fit, at(40.0, 20.0, 32.0), PAIRS)
    np.testing.assert_array_equal(found.speed, [20.0, 32.0, 40.0])
    faster, C = (found.speed - 30) / 10, fit.covariance
    np.testing.assert_allclose(found.values[:, 0], fit.model.Mq + fit.model.Mq_V * faster)
    np.testing.assert_allclose(found.values[:, 1], fit.model.Mlon * found.speed)
    variance = C[0, 0] + 2 * faster * C[0, 1] + faster**2 * C[1, 1]
    np.testing.assert_allclose(found.std_error[:, 0], np.sqrt(variance))
    np.testing.assert_allclose(found.std_error[:, 1], np.sqrt(C[2, 2]) * found.speed)
    np.testing.assert_allclose(np.sort(found.poles.real, axis=1)[:, 0], found.values[:, 0])


def test_what_is_held_has_no_error():
    held = output_error(Faster(), flown(20.0), biases=False, fixed=("Mq_V",))
    found = envelope(held, at(20.0), PAIRS)
    assert found.std_error[0, 0] == pytest.approx(held["Mq"].std_error)


def test_nobody_knows_the_error_of_what_depends_on_a_parameter_on_its_bound(fit):
    rows = [replace(row, active=row.name == "Mq_V") for row in fit.parameters]
    C = np.where(np.eye(3)[1], 0.0, fit.covariance) * (1 - np.eye(3)[1])[:, None]
    stuck = replace(fit, parameters=tuple(rows), covariance=C)
    errors = envelope(stuck, at(20.0, 30.0, 40.0), PAIRS).std_error
    assert np.isnan(errors[[0, 2], 0]).all()
    np.testing.assert_allclose(errors[1, 0], np.sqrt(C[0, 0]))  # where Mq_V does nothing
    np.testing.assert_allclose(errors[:, 1], np.sqrt(C[2, 2]) * np.array([20.0, 30.0, 40.0]))


class Climbing(NonlinearModel):
    """w' = thr - k u w - e w² at a thrust that is flown; in balance w has a closed form."""

    states, inputs, outputs = ("u", "w"), ("push", "thr"), ("u", "w")

    k: Scalar = parameter(default=0.05, lower=0.0, upper=1.0, unit="1/m")
    e: Scalar = parameter(default=0.3, lower=0.0, upper=1.0, unit="1/m")

    def derivatives(self, x, u):
        return [u.push, u.thr - self.k * x.u * x.w - self.e * x.w**2]

    def reference(self):
        return {"u": 30.0, "w": 2.0, "thr": 4.0}


@pytest.mark.second
def test_errors_count_that_what_a_condition_leaves_open_moves_with_the_estimates():
    t, rng = 0.1 * np.arange(300), np.random.default_rng(3)
    u = np.column_stack([0 * t, 4.0 + 0.5 * np.sign(np.sin(0.7 * t))])
    still = Record(t, u, np.zeros((300, 2)), Climbing.inputs, Climbing.outputs, "heave")
    record = simulate(Climbing(k=0.06, e=0.2), still, {"u": 30.0, "w": 1.8})
    fit = output_error(Climbing(), record.with_noise({"u": 0.1, "w": 0.02}, rng), biases=False)
    trim = Trim(name="level", values={"u": 30.0, "thr": 4.0}, speed=30.0)
    found = envelope(fit, [trim], [("w", "w"), ("w", "u")])
    k, e, V, T = fit.model.k, fit.model.e, 30.0, 4.0
    root = np.sqrt((k * V) ** 2 + 4 * e * T)  # w' by w is its negative; w = (root - k V) / 2 e
    by_k, by_e = k * V**2 / root, 2 * T / root
    w, w_by_k = (root - k * V) / (2 * e), (by_k - V) / (2 * e)
    w_by_e = by_e / (2 * e) - (root - k * V) / (2 * e**2)
    J = -np.array([[by_k, by_e], [w + k * w_by_k, k * w_by_e]])
    np.testing.assert_allclose(found.values[0], [-root, -k * w], rtol=1e-8)
    expected = np.sqrt(np.diag(J @ fit.covariance @ J.T))
    np.testing.assert_allclose(found.std_error[0], expected, rtol=1e-5)


@pytest.mark.second
def test_of_two_balances_that_is_shown_which_the_records_flew():
    t, rng = 0.05 * np.arange(200), np.random.default_rng(5)
    e = 1 + 0.1 * np.sin(0.9 * t)
    still = Record(t, e[:, None], np.zeros((200, 2)), Twofold.inputs, Twofold.outputs, "twofold")
    record = simulate(Twofold(), still, {"V": 10.0, "w": -1.0})
    flown, start = record.with_noise({"V": 0.02, "az": 0.01}, rng), Twofold(a=0.3, d=0.5)
    fit = output_error(start, flown, biases=False)
    trim = Trim(name="level", values={"V": 10.0, "e": 1.0})
    found = envelope(fit, [trim], [("w", "w")])
    assert found.values[0, 0] == pytest.approx(-2 * fit.model.a)  # 2 a w at w = -1
    assert found.doubts == ()
    with pytest.warns(
        DataWarning, match="balance is in doubt, at level .* also balances with w = -1"
    ):
        told = envelope(replace(fit, initial_states=None), [trim], [("w", "w")])
    assert len(told.doubts) == 1


def test_an_input_called_u_is_no_airspeed():
    class Stick(Faster):
        """The same, its speed called V, its stick u."""

        states, inputs, outputs = ("V", "q"), ("u", "push"), ("V", "q")

        def derivatives(self, x, u):
            damping = self.Mq + self.Mq_V * (x.V - 30.0) / 10.0
            return [u.push, damping * x.q + self.Mlon * x.V * u.u]

        def reference(self):
            return {"V": 30.0}

    record = flown(20.0).rename({"u": "V", "lon": "u"})
    still = output_error(Stick(), record, biases=False, fixed=("Mq_V",))
    found = envelope(still, [Trim(values={"V": 20.0, "u": 0.0})], PAIRS[:1])
    assert found.speed.tolist() == [20.0]
    with pytest.raises(ValueError, match="has no speed"):
        envelope(still, [Trim(values={"u": 0.0})], PAIRS[:1])


def test_conditions_that_were_not_flown_are_told_and_drawn_without_a_band(fit):
    plt = pytest.importorskip("matplotlib.pyplot")
    with pytest.warns(DataWarning, match=r"at 5, 100 m/s, outside .*\(u 19\.98 to 39\.99\)"):
        found = envelope(fit, at(5.0, 20.0, 40.0, 100.0), PAIRS)
    assert found.beyond.tolist() == [True, False, False, True]
    assert "2 outside what was flown" in repr(found)
    ax = found.plot()[0]
    solid, dashed = ax.get_lines()
    assert np.isfinite(solid.get_ydata()).tolist() == [False, True, True, False]
    assert dashed.get_linestyle() == "--"
    assert ax.collections[0].get_paths()[0].vertices[:, 0].max() <= 40.0
    plt.close("all")


def test_what_is_beyond_what_was_flown_is_so_by_a_tenth_of_the_span():
    held = output_error(Faster(), [flown(20.0), flown(40.0)], biases=False)
    with pytest.warns(DataWarning, match="extrapolated at 17, 43 m/s"):
        found = envelope(held, at(17.0, 18.5, 41.5, 43.0), PAIRS)
    assert found.beyond.tolist() == [True, False, False, True]


def test_conditions_of_a_match_are_what_it_covers():
    truth = Faster(Mq=-1.2, Mq_V=-0.3, Mlon=0.25)
    targets = {trim: truth.at(trim).system() for trim in at(22.0, 38.0)}
    found = match(Faster(), targets, norm="quadratic")
    with pytest.warns(DataWarning, match=r"at 15, 45 m/s, outside .*\(u 22 to 38\)"):
        told = envelope(found, at(15.0, 30.0, 45.0), PAIRS)
    assert told.beyond.tolist() == [True, False, True]


def test_trims_of_other_names_or_no_numbers_are_refused(fit):
    with pytest.raises(ValueError, match="trim names 'speed', which is no channel of Faster"):
        envelope(fit, [Trim(values={"u": 20.0, "speed": 3.0})], PAIRS)
    with pytest.raises(ValueError, match="trim 'cruise': u is nan, expected a number"):
        envelope(fit, [Trim(values={"u": np.nan}, name="cruise", speed=20.0)], PAIRS)


def test_conditions_of_equal_values_at_two_speeds_are_two(fit):
    local = {Trim(values={"u": 25.0}, speed=V): fit for V in (20.0, 30.0)}
    assert envelope(fit, at(25.0), PAIRS, local=local).local.speed.tolist() == [20.0, 30.0]


def test_local_fits_stand_at_their_speeds(fit):
    record = flown(20.0).detrend({"u": 20.0, "q": 0.0, "lon": 0.0, "push": 0.0})
    own = output_error(Local(), record)
    found = envelope(fit, at(20.0, 40.0), PAIRS, local={at(20.0)[0]: own}).local
    assert found.values[0].tolist() == [own.model.Mq, own.model.M]
    np.testing.assert_allclose(found.std_error[0], [row.std_error for row in own.parameters])
    assert "1 local fits" in repr(envelope(fit, at(20.0), PAIRS, local={at(20.0)[0]: own}))


def test_what_lies_off_the_one_model_is_told_and_the_report_leads_with_it(fit):
    record = flown(20.0).detrend({"u": 20.0, "q": 0.0, "lon": 0.0, "push": 0.0})
    own = output_error(Local(), record)
    there = envelope(fit, at(20.0, 40.0), PAIRS, local={at(20.0)[0]: own})
    assert there.apart == ()
    off = replace(own, model=replace(own.model, Mq=own.model.Mq - 8 * own["Mq"].std_error))
    found = envelope(fit, at(20.0, 40.0), PAIRS, local={at(20.0)[0]: off})
    (said,) = found.apart
    assert said.startswith(f"q' by q at 20 m/s is {off.model.Mq:.3g} ± ")
    assert said.endswith("by the one model")
    assert "1 local fits beside them (1 of their entries off it)" in found.headline()
    ((caution,),) = (section.cautions for section in _show(found, SimpleNamespace(model=fit.model)))
    assert caution.rank <= LEADING
    assert said in caution.text


@pytest.mark.parametrize("known", [1e-9, 1.0], ids=["well", "no better"])
def test_chance_calls_one_campaign_in_a_hundred_off(fit, known):
    rng = np.random.default_rng(17)
    made = envelope(fit, at(*np.linspace(20.0, 40.0, 9)), PAIRS)

    def drawn(share):
        values = made.values + share * made.std_error * rng.standard_normal((9, 2))
        return replace(made, values=values, std_error=share * made.std_error)

    told = [bool(_apart(drawn(known), drawn(1.0))) for _ in range(3000)]
    assert np.mean(told) == pytest.approx(0.01, abs=4 * np.sqrt(0.01 / 3000))


def test_poles_are_followed_where_they_cross(fit):
    poles = envelope(fit, at(20.0, 25.0, 30.0, 35.0, 40.0), PAIRS).poles
    still = np.argmin(np.abs(poles[0]))  # that of u, in every row
    np.testing.assert_allclose(poles[:, still], 0.0, atol=1e-12)


def test_the_figures_have_bands_points_and_loci(fit):
    plt = pytest.importorskip("matplotlib.pyplot")
    found = envelope(fit, at(20.0, 40.0), PAIRS, local=dict.fromkeys(at(30.0), fit))
    axes = found.plot()
    titles = ["q' by q [rad/s² per rad/s]", "q' by lon [rad/s² per travel]"]
    assert [ax.get_title(loc="left") for ax in axes] == titles
    assert axes[0].containers, "no point of a local fit"
    loci = found.plot(modes=True)
    assert "20 to 40 m/s" in loci.get_title(loc="left")
    assert "q&#39; by lon" in found._repr_html_()
    plt.close("all")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"trims": []}, "at least one trim"),
        ({"trims": [Trim(values={"q": 0.0}, name="hover")]}, "'hover' has no speed"),
        ({"entries": [("q", "ped")]}, "no derivative of 'q' by 'ped'"),
    ],
)
def test_bad_arguments_are_named(fit, change, words):
    given = {"trims": at(20.0), "entries": PAIRS} | change
    with pytest.raises((ValueError, ModelError), match=words):
        envelope(fit, **given)


def test_a_linear_fit_has_no_envelope():
    record = flown(20.0).detrend({"u": 20.0, "q": 0.0, "lon": 0.0, "push": 0.0})
    with pytest.raises(ModelError, match="Local is linear"):
        envelope(output_error(Local(), record), at(20.0), PAIRS)


class Sinking(NonlinearModel):
    """w' = g - k u w - e w², of which the slope at balance is -sqrt((k u)² + 4 e g)."""

    states, inputs, outputs = ("u", "w"), ("push",), ("u", "w")

    k: Scalar = parameter(default=0.06, lower=0.0, upper=1.0, unit="1/m")
    e: Scalar = parameter(default=0.2, lower=-1.0, upper=1.0, unit="1/m")

    def derivatives(self, x, u):
        return [u.push, 9.80665 - self.k * x.u * x.w - self.e * x.w**2]

    def reference(self):
        return {"u": 30.0, "w": 3.0}


def sunk(e):
    t = 0.1 * np.arange(50)
    still = Record(t, 0 * t[:, None], np.zeros((50, 2)), ("push",), ("u", "w"), "sunk")
    record = simulate(Sinking(), still, {"u": 30.0, "w": 3.0})
    noisy = record.with_noise({"u": 0.01, "w": 0.01}, np.random.default_rng(0))
    made = output_error(Sinking(), noisy, biases=False)
    return replace(made, model=Sinking(e=e))


def test_what_trims_do_not_name_is_balanced_at_each_speed():
    trims = [Trim(values={"u": V, "push": 0.0}, speed=V) for V in (30.0, 29.9)]
    found = envelope(sunk(0.2), trims, [("w", "w")])
    slopes = -np.sqrt((0.06 * found.speed) ** 2 + 4 * 0.2 * 9.80665)
    np.testing.assert_allclose(found.values[:, 0], slopes, rtol=1e-8)
    assert found.balanced == ("w",)
    assert found.doubts == ()


@pytest.mark.second
def test_conditions_without_balance_are_told():
    with pytest.warns(
        DataWarning, match=r"Sinking is linearised .* 30 m/s .*d/dt w = 5\.76 instead"
    ):
        found = envelope(
            sunk(-0.2), [Trim(values={"u": 30.0, "push": 0.0}, name="30 m/s")], [("w", "w")]
        )
    (caution,) = next(iter(_show(found, SimpleNamespace(model=Sinking())))).cautions
    assert caution.rank <= LEADING
    assert "at 30 m/s with w = 4.5: d/dt w" in caution.text
