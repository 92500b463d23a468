"""What can be told apart: against closed forms, and against parameters known to be confounded."""

import numpy as np
import pytest
from truths.systems import known_black_box

from casid import (
    Constraint,
    FrequencyResponse,
    Model,
    ModelError,
    NonlinearModel,
    Record,
    Rows,
    Scalar,
    parameter,
)
from casid.structure.identifiability import identifiability
from models.short_period import ShortPeriod
from models.six_dof import SixDof

T = 0.02 * np.arange(800)
DOUBLET = np.where((T > 1) & (T < 2), 1.0, 0.0) - np.where((T >= 2) & (T < 3), 1.0, 0.0)


class Lag(Model):
    """b c / (s + a): only the product of b and c is felt; d is not used."""

    states = ("x",)
    inputs = ("u",)
    outputs = ("x",)
    a: Scalar = parameter(default=1.0, lower=0.1, upper=5.0, unit="1/s")
    b: Scalar = parameter(default=2.0, lower=0.0, upper=5.0, unit="-")
    c: Scalar = parameter(default=0.0, lower=-5.0, upper=5.0, unit="-")
    d: Scalar = parameter(default=1.0, unit="-")

    def A(self) -> Rows:
        return [[-self.a]]

    def B(self) -> Rows:
        return [[self.b * self.c]]


def flown(model, u=DOUBLET, t=T, **changes):
    system = model.system()
    y = system.simulate(t, u[:, None])
    return Record(t, u[:, None], y, system.inputs, system.outputs, **changes)


@pytest.mark.parametrize("kind", ["records", "black box", "response"])
def test_a_product_and_an_unused_parameter_are_named(kind):
    model = Lag(c=0.7)
    system = model.system()
    omega = np.geomspace(0.1, 10, 30)
    G = system.response(omega)
    sizes = {"input_std": np.ones(1), "output_std": np.ones(1)}
    data = {
        "records": [flown(model)],
        "black box": known_black_box(system),
        "response": FrequencyResponse(
            omega=omega, G=G, coherence=np.ones(G.shape), random_error=np.zeros(G.shape),
            inputs=("u",), outputs=("x",), **sizes,
        ),
    }[kind]  # fmt: skip
    found = identifiability(model, data)
    assert not found.identifiable
    assert found.rank == 2
    assert np.isinf(found.condition)
    assert found.insensitive == ("d",)
    assert found.confounded == (("b", "c"),)
    np.testing.assert_array_equal(np.isinf(found.inflation), [False, True, True, False])
    assert "cannot be told apart: b and c; fix one" in str(found)
    assert "no output depends on d: fix or drop" in str(found)


def test_fixing_one_of_each_group_makes_the_rest_identifiable():
    found = identifiability(Lag(c=0.7), [flown(Lag(c=0.7))], fixed=("b", "d"))
    assert found.identifiable
    assert found.names == ("a", "c")
    assert found.confounded == found.insensitive == ()
    assert 1 <= found.condition < 100
    assert str(found).startswith("rank 2 of 2")


def test_a_zero_guess_hides_nothing_unless_asked_to():
    # At c = 0 the output does not feel a; next to it it does.
    assert identifiability(Lag(), [flown(Lag(c=1.0))], fixed=("b", "d")).identifiable
    there = identifiability(Lag(), [flown(Lag(c=1.0))], fixed=("b", "d"), spread=0.0)
    assert there.insensitive == ("a",)


class Driven(Model):
    """x' = -a x + b u: without b nothing is felt."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a: Scalar = parameter(default=1.0, lower=0.1, upper=5.0, unit="1/s")
    b: Scalar = parameter(default=2.0, lower=0.0, upper=1e6, unit="-")

    def A(self) -> Rows:
        return [[-self.a]]

    def B(self) -> Rows:
        return [[self.b]]


@pytest.mark.parametrize("seed", range(4))
def test_a_bound_as_far_as_one_likes_moves_no_parameter_where_nothing_is_felt(seed):
    for highest in (5.0, 1e6, 1e9):
        found = identifiability(Driven(), flown(Driven()), bounds={"b": (0.0, highest)}, seed=seed)
        assert (found.rank, found.insensitive) == (2, ())


def test_information_of_a_black_box_is_its_closed_form():
    # g = c / (s + a): the relative derivatives are -1/(s + a) and 1/c.
    model = Lag(a=2.0, b=1.0, c=3.0)
    found = identifiability(model, known_black_box(model.system()), fixed=("b", "d"), spread=0.0)
    s = 1j * np.geomspace(0.1, 10.0, 40)
    J = np.column_stack([-1 / (s + 2), np.full(40, 1 / 3)])
    unit = np.exp(1j * np.angle(1 / (s + 2)))[:, None]  # of g itself, which turns nothing
    np.testing.assert_allclose(
        found.information, np.real((J * unit).conj().T @ (J * unit)), rtol=1e-10
    )


def test_information_of_a_record_is_that_of_its_sensitivities():
    # Sensitivities by differences of simulations, initial state and bias projected out in time.
    model = Lag(a=1.5, b=1.0, c=2.0)
    record = flown(model)
    found = identifiability(model, [record], fixed=("b", "d"), spread=0.0)
    h = 1e-5
    moved = {
        name: (flown(Lag(**(values | {name: values[name] + h}))).y - record.y) / h
        for values in [{"a": 1.5, "b": 1.0, "c": 2.0}]
        for name in ("a", "c")
    }
    J = np.column_stack([moved["a"], moved["c"]]) / record.y.std()
    nuisance = np.column_stack([np.exp(-1.5 * T), np.ones(len(T))])
    J -= nuisance @ np.linalg.lstsq(nuisance, J)[0]
    # Neither transform knows what lies between samples or beyond the end: a few per cent.
    np.testing.assert_allclose(found.information, J.T @ J, rtol=0.05)


class NonlinearLag(NonlinearModel):
    """The same lag about a trim that the record's bias hides."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a: Scalar = parameter(default=1.5, lower=0.1, upper=5.0, unit="1/s")
    c: Scalar = parameter(default=2.0, lower=-5.0, upper=5.0, unit="-")

    def derivatives(self, x, u):
        return [-self.a * x.x + self.c * u.u]


def test_a_nonlinear_structure_that_is_linear_has_the_information_of_that():
    # Not more: initial states and biases are unknown in both.
    record = flown(Lag(a=1.5, b=1.0, c=2.0))
    linear = identifiability(Lag(a=1.5, b=1.0, c=2.0), record, fixed=("b", "d"), spread=0.0)
    found = identifiability(NonlinearLag(), record, spread=0.0)
    assert found.names == linear.names
    np.testing.assert_allclose(found.information, linear.information, rtol=0.05)


def test_a_constant_input_tells_nothing_apart():
    still = Record(T, np.ones((800, 1)), np.ones((800, 1)), ("u",), ("x",))
    found = identifiability(Lag(c=0.7), [still], fixed=("b", "d"))
    assert not found.identifiable


class PitchRate(ShortPeriod):
    """The short period seen by the rate gyro alone."""

    outputs = ("q",)

    def C(self) -> Rows:
        return [[0, 1]]

    def D(self) -> Rows:
        return [[0]]


def test_pitch_rate_alone_holds_five_of_the_short_periods_seven_parameters():
    # q/lon = Mlon (s + z) e^(-τs) / (s² + 2ζω s + ω²) has five coefficients.
    t = 0.02 * np.arange(500)
    u = 0.05 * np.interp(t, T, DOUBLET)
    found = identifiability(PitchRate(), [flown(PitchRate(), u, t)])
    assert found.rank == 5
    named = {name for group in found.confounded for name in group}
    assert named == {"Zw", "Zq", "Mw", "Mq", "Zlon"}
    assert identifiability(ShortPeriod(), [flown(ShortPeriod(), u, t)]).identifiable


def test_the_unstable_six_degrees_of_freedom_are_identifiable_from_one_input_each():
    rng = np.random.default_rng(0)
    records = []
    for i, name in enumerate(SixDof.inputs):
        u = np.zeros((800, 4))
        u[:, i] = 0.05 * DOUBLET
        records.append(
            Record(T, u, rng.standard_normal((800, 8)), SixDof.inputs, SixDof.outputs, name)
        )
    assert identifiability(SixDof(), records).rank == 64
    alone = identifiability(SixDof(), records[:1])
    assert {"Xlat", "Xlon", "Xped", "tau_lat", "tau_lon", "tau_ped"} <= set(alone.insensitive)


def test_wrong_arguments_are_told():
    with pytest.raises(ValueError, match="no data given"):
        identifiability(Lag(), [])
    with pytest.raises(ValueError, match="data is a NoneType"):
        identifiability(Lag(), None)
    with pytest.raises(ModelError, match="no parameter 'e'"):
        identifiability(Lag(), [flown(Lag(c=1.0))], fixed=("e",))
    with pytest.raises(ValueError, match="no pair in common"):
        identifiability(Lag(), known_black_box(ShortPeriod().system()))
    with pytest.raises(ValueError, match="has no input 'lon'"):
        identifiability(ShortPeriod(), [flown(Lag(c=1.0))])


class TiedRoll(Model):
    """A roll whose steady gain T is said by a tie alone."""

    states = ("p",)
    inputs = ("lat",)
    outputs = ("p",)
    Lp: Scalar = parameter(default=-4.0, lower=-25.0, upper=0.0, unit="1/s")
    L: Scalar = parameter(default=10.0, lower=0.0, upper=60.0, unit="rad/s^2")
    T: Scalar = parameter(default=2.5, lower=0.0, upper=20.0, unit="rad/s")
    wide: bool = False

    def A(self) -> Rows:
        return [[self.Lp]]

    def B(self) -> Rows:
        return [[self.L]]

    def constraints(self):
        return [Constraint("gain", self.L + self.Lp * self.T, 0.0, 1.0 if self.wide else 0.0)]


def test_what_only_a_tie_tells_is_neither_lost_nor_to_be_fixed():
    found = identifiability(TiedRoll(), flown(TiedRoll()))
    assert found.identifiable
    assert found.tied == ("T",)
    assert found.insensitive == ()
    assert "only the structure's constraints determine T" in str(found)
    loose = identifiability(TiedRoll(wide=True), flown(TiedRoll(wide=True)))
    assert loose.insensitive == ("T",)
    assert not loose.identifiable
