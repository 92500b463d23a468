"""Equations as text: run as Python, and as MATLAB after its brackets are changed."""

import re
import runpy
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from truths.climbing import AIRCRAFT, DT, X0, by_casid, commands
from truths.systems import unstable_plant

from casid import StateSpace, equations_of, without_delay, write_equations
from models.longitudinal_aero import LongitudinalAero

pytestmark = pytest.mark.filterwarnings("ignore:direct terms of delayed inputs")


def as_matlab(text, x, u):
    """What MATLAB computes: the statements with Python's brackets and power."""
    scope = {
        name: getattr(np, name) for name in ("sin", "cos", "tan", "tanh", "exp", "log", "sqrt")
    }
    scope |= {"min": min, "max": max, "x": x, "u": u}
    scope["if_true"] = lambda condition, value: value if condition else 0.0
    own = text[text.index("dx = ") : text.index("\nend\n")]
    own = re.sub(r"zeros\((\d+), 1\)", r"[0.0] * \1", own).replace("^", "**").replace(";", "")
    own = re.sub(r"\b(x|u|dx|y)\((\d+)\)", lambda m: f"{m[1]}[{int(m[2]) - 1}]", own)
    exec(own, scope)
    return scope["dx"], scope["y"]


@pytest.mark.parametrize("model", [AIRCRAFT, LongitudinalAero()], ids=["climbing", "wing"])
def test_text_computes_what_the_structure_does(tmp_path, model):
    found = equations_of(model, 2)
    write_equations(tmp_path / "own.py", found, title='a "title"')
    write_equations(tmp_path / "own.m", found)
    module, text = runpy.run_path(str(tmp_path / "own.py")), (tmp_path / "own.m").read_text("utf-8")
    rng = np.random.default_rng(1)
    for _ in range(5):
        x = found.x0 + 0.2 * rng.standard_normal(len(found.x0))
        u = found.u0 + 0.1 * rng.standard_normal(len(found.u0))
        known = found.derivatives(0.0, x, u), found.measurements(0.0, x, u)
        for other in (module["equations"](x, u), as_matlab(text, x, u)):
            for one, own in zip(known, other, strict=True):
                np.testing.assert_allclose(own, one, rtol=1e-12, atol=1e-12)
    assert module["INPUTS"] == model.inputs
    assert module["X0"] == found.x0.tolist()
    assert text.startswith("function [dx, y] = own(x, u)")


def test_a_name_that_no_language_takes_is_refused(tmp_path):
    for name in ("model.txt", "my model.m", "for.m", "end.m", "class.py"):
        with pytest.raises(ValueError, match=r"such as model\.m"):
            write_equations(tmp_path / name, equations_of(AIRCRAFT, 1))


def both_texts(folder, function, outputs):
    """Equations of two states and an input, as a module of Python and as MATLAB's text."""
    found = replace(
        equations_of(AIRCRAFT, 1),
        states=("a", "b"),
        inputs=("c",),
        outputs=outputs,
        x0=np.zeros(2),
        u0=np.zeros(1),
        function=function,
    )
    write_equations(folder / "own.py", found)
    write_equations(folder / "own.m", found)
    return runpy.run_path(str(folder / "own.py")), (folder / "own.m").read_text("utf-8")


def test_conditions_and_signs_have_a_form_in_text(tmp_path):
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 1)
    both, either = ca.logic_and(x[0] > 0, x[1] > 0), ca.logic_or(x[0] > 0, x[1] > 0)
    rates = ca.vertcat(ca.sign(x[0]), ca.copysign(x[0], x[1]))
    told = ca.Function("equations", [x, u], [rates, ca.vertcat(both, either, x[0] != x[1])])
    module, text = both_texts(tmp_path, told, ("d", "e", "f"))
    for at in ([1.0, -2.0], [-1.0, 2.0], [3.0, 3.0], [0.0, -1.0], [-1.0, -1.0]):
        known = [part.full().ravel() for part in told(at, [0.0])]
        for other in (module["equations"](at, [0.0]), as_matlab(text, at, [0.0])):
            for one, own in zip(known, other, strict=True):
                np.testing.assert_array_equal(own, one)


def test_branches_that_are_not_taken_need_no_value(tmp_path):
    # As of an angle of attack at rest: what is asked for stays finite, and is not real elsewhere.
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 1)
    angle = ca.if_else(x[0] > 0.1, x[1] / x[0], 0.0)
    root = ca.if_else(x[1] > 0, ca.sqrt(x[1]) + x[1] ** 1.5, 2.0)
    told = ca.Function("equations", [x, u], [ca.vertcat(angle, root), ca.log(x[1])])
    module, text = both_texts(tmp_path, told, ("d",))
    for at in ([0.0, -1.0], [1.0, -2.0], [0.0, 1.0], [2.0, 4.0]):
        known = [part.full().ravel() for part in told(at, [0.0])]
        with np.errstate(all="ignore"):
            matlab = as_matlab(text, np.array(at), [0.0])
        for other in (module["equations"](at, [0.0]), matlab):
            for one, own in zip(known, other, strict=True):
                np.testing.assert_allclose(own, one, rtol=1e-12)


def test_an_operation_without_a_form_is_named(tmp_path):
    x, u = ca.SX.sym("x", 1), ca.SX.sym("u", 1)
    told = ca.Function("equations", [x, u], [ca.floor(x), x])
    with pytest.raises(ValueError, match="the structure uses floor, which has no form in text"):
        write_equations(tmp_path / "own.m", replace(equations_of(AIRCRAFT, 1), function=told))


RUN = """
f = @(x, u) nthargout(1, @own, x, u); h = @(x, u) nthargout(2, @own, x, u);
y = simulate(f, h, t, u, x0, delay);
"""


@pytest.mark.slow
def test_octave_integrates_a_linear_system_as_casid(tmp_path, octave):
    plant = unstable_plant()
    names = plant.inputs, plant.outputs, ()
    system = StateSpace(plant.A, plant.B, plant.C, plant.D, None, *names, np.array([0.05, 0.0]))
    write_equations(tmp_path / "own.m", equations_of(system, 3))
    t, x0 = 0.1 * np.arange(8), np.r_[np.arange(5.0) / 5, 0, 0, 0]
    u = np.random.default_rng(4).uniform(-1, 1, (len(t), 2))
    y = octave(RUN, t=t[:, None], u=u, x0=x0, delay=np.zeros(2))
    known = without_delay(system, 3).simulate(t, u, x0)
    np.testing.assert_allclose(y, known, atol=1e-8 * np.abs(known).max(), rtol=0)


@pytest.mark.slow
def test_octave_integrates_a_nonlinear_structure_as_casid(tmp_path, octave):
    write_equations(tmp_path / "own.m", equations_of(replace(AIRCRAFT, tau=0.0)))
    t, u = DT * np.arange(25), commands()
    y = octave(RUN, t=t[:, None], u=u[:25], x0=X0, delay=np.array([AIRCRAFT.tau, 0.0]))
    known = by_casid(AIRCRAFT, u, "foh", 20)[:25]
    np.testing.assert_allclose(y, known, atol=1e-8 * np.abs(known).max(), rtol=0)


def test_the_head_of_a_function_says_what_its_values_and_its_states_are(tmp_path):
    plant = unstable_plant()
    D, none = np.array([[0.0, 1.0]] * 3), np.zeros((3, 2))
    for delay, direct in ((np.array([0.0, 0.05]), D), (np.array([0.053, 0.04]), none)):
        names = plant.inputs, plant.outputs, ()
        system = StateSpace(plant.A, plant.B, plant.C, direct, None, *names, delay)
        found = equations_of(system, 3, {plant.inputs[0]: "rad"})
        write_equations(tmp_path / "own.m", found)
        head = (tmp_path / "own.m").read_text(encoding="utf-8").partition("\ndx =")[0]
        said = " ".join(line.lstrip("% ") for line in head.splitlines())
        assert f"{plant.inputs[0]} [rad]" in said
        assert "deviations from the trim" in said
        for name, tau in zip(plant.inputs, delay, strict=True):
            assert (f"{name}_1 to {name}_3 that of {name}, {tau:.6g} s" in said) == (tau > 0)
        assert ("Direct terms of delayed inputs" in said) == (direct is D)


def test_the_head_of_a_nonlinear_structure_says_total_values(tmp_path):
    for name in ("own.m", "own.py"):
        write_equations(tmp_path / name, equations_of(replace(AIRCRAFT, tau=0.0)))
        said = (tmp_path / name).read_text(encoding="utf-8")
        assert "u and y are total values" in said
        assert "Padé" not in said
