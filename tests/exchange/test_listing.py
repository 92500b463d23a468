"""Equations as text: run as Python, and as MATLAB after its brackets are changed."""

import re
import runpy

import numpy as np
import pytest
from truths.climbing import AIRCRAFT

from casid import equations_of, write_equations
from models.longitudinal_aero import LongitudinalAero


def as_matlab(text, x, u):
    """What MATLAB computes: the statements with Python's brackets and power."""
    scope = {name: getattr(np, name) for name in ("sin", "cos", "tan", "tanh", "exp", "sqrt")}
    scope |= {"min": min, "max": max, "x": x, "u": u}
    own = text[text.index("dx = ") : text.rindex("end")]
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
    for name in ("model.txt", "my model.m"):
        with pytest.raises(ValueError, match=r"such as model\.m"):
            write_equations(tmp_path / name, equations_of(AIRCRAFT, 1))
