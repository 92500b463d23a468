"""The equations of a model as text: a function file of MATLAB, or a Python module."""

import keyword
from pathlib import Path
from textwrap import wrap

import casadi as ca

from casid.exchange.equations import Equations
from casid.textfile import write_text

KEYWORDS = "case catch end function otherwise parfor persistent spmd switch"  # of MATLAB alone

BINARY = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_FMIN: "{least}({}, {})",
    ca.OP_FMAX: "{most}({}, {})",
    ca.OP_LT: "({} < {}) + 0.0",
    ca.OP_LE: "({} <= {}) + 0.0",
    ca.OP_EQ: "({} == {}) + 0.0",
    ca.OP_NE: "({0} < {1}) + ({0} > {1}) + 0.0",  # the languages spell unequal differently
    ca.OP_AND: "(abs({}) > 0) * (abs({}) > 0) + 0.0",
    ca.OP_OR: "((abs({}) > 0) + (abs({}) > 0) > 0) + 0.0",
    ca.OP_COPYSIGN: "abs({}) * (1 - 2 * ({} < 0))",
    ca.OP_ATAN2: "atan2({}, {})",
    ca.OP_HYPOT: "hypot({}, {})",
    ca.OP_POW: "{} {power} {}",
    ca.OP_CONSTPOW: "{} {power} {}",
    ca.OP_IF_ELSE_ZERO: "if_true({}, {})",
}
UNARY = {
    ca.OP_ASSIGN: "{}",
    ca.OP_NEG: "-{}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2 * {}",
    ca.OP_INV: "1 / {}",
    ca.OP_NOT: "1 - {}",
    ca.OP_FABS: "abs({})",
    ca.OP_SIGN: "({0} > 0) + 0.0 - ({0} < 0)",
} | {
    getattr(ca, f"OP_{name.upper()}"): f"{name}({{}})"
    for name in (
        *("exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf", "expm1", "log1p"),
    )
}

WIDTH = 90  # of a line of remarks
WORDS = {  # of a language, what is spelled otherwise; numbers of NumPy are as those of C
    "py": {"power": "**", "least": "fmin", "most": "fmax", "number": "float64({})", "at": "[{}]"},
    "m": {"power": "^", "least": "min", "most": "max", "number": "{}", "at": "({})"},
}
MATLAB = """function [dx, y] = {name}(x, u)
%{upper} {about}
%   States x: {states}
%   Inputs u: {inputs}
%   Outputs y: {outputs}
{remarks}
%   Reference condition: x0 = {x0}; u0 = {u0}
%   [t, x] = ode45(@(t, x) {name}(x, u_of(t)), [0 10], x0, odeset('RelTol', 1e-8))
dx = zeros({nx}, 1);
y = zeros({ny}, 1);
{body}
end

function z = if_true(condition, value)
% VALUE, which may not exist elsewhere, where CONDITION holds; zero elsewhere.
z = 0;
if condition
    z = value;
end
end
"""
PYTHON = '''"""{about}

{remarks}

scipy.integrate.solve_ivp(lambda t, x: equations(x, u_of(t))[0], (0.0, 10.0), X0, rtol=1e-8)
NumPy 2 or newer.
"""

from numpy import *
from scipy.special import erf

STATES = {states!r}
INPUTS = {inputs!r}
OUTPUTS = {outputs!r}
UNITS = {units!r}
X0 = {x0!r}
U0 = {u0!r}


def if_true(condition, value):
    """The value, which may not exist elsewhere, where a condition holds; zero elsewhere."""
    return value if condition else 0.0


@errstate(all="ignore")
def equations(x, u):
    """dx/dt and outputs, lists of {nx} and {ny}, of states and inputs."""
    dx, y = [0.0] * {nx}, [0.0] * {ny}
{body}
    return dx, y
'''


def write_equations(path: str | Path, found: Equations, *, title: str = "") -> None:
    """Write dx/dt and y as a MATLAB function (``.m``) or a Python module (``.py``) of plain text.

    Parameters
    ----------
    path : path
        Its stem becomes the function's name in MATLAB; replaced if it is there.
    found : Equations
        From `equations_of`.
    title : str
        First line of the file.

    Raises
    ------
    ValueError
        Another suffix, a name that neither takes, an operation that has no form there.
    """
    path = Path(path)
    named = path.stem.isidentifier() and path.stem not in (*keyword.kwlist, *KEYWORDS.split())
    if path.suffix not in (".m", ".py") or not named:
        raise ValueError(f"{path}: expected a name such as model.m or model.py")
    said = _plain(title)
    told = {"about": said or f"Equations of {path.stem}.", "nx": len(found.x0)}
    told |= {"ny": len(found.outputs), "x0": found.x0.tolist(), "u0": found.u0.tolist()}
    sentences = [f"{_plain(each)}." for each in found.remarks]
    if path.suffix == ".py":
        told["remarks"] = "\n".join(wrap(" ".join(sentences), WIDTH))
        body = "\n".join(f"    {line}" for line in _lines(found.function, "py"))
        names = {name: getattr(found, name) for name in ("states", "inputs", "outputs")}
        own = (*found.states, *found.inputs, *found.outputs)
        units = {name: found.units[name] for name in own if name in found.units}
        text = PYTHON.format(**told, **names, units=units, body=body)
    else:
        lines = (line for each in sentences for line in wrap(each, WIDTH, subsequent_indent="  "))
        told["remarks"] = "\n".join(f"%   {line}" for line in lines)
        body = "\n".join(f"{line};" for line in _lines(found.function, "m"))
        names = {
            name: ", ".join(f"{n} [{found.units.get(n, '-')}]" for n in getattr(found, name))
            for name in ("states", "inputs", "outputs")
        }
        text = MATLAB.format(**told, **names, name=path.stem, upper=path.stem.upper(), body=body)
    write_text(path, text)


def _plain(text: str) -> str:
    """A text without what could end a docstring or a line of comment."""
    return "".join(each for each in text if each.isprintable() and each not in "\\\"'")


def _lines(function: ca.Function, language: str) -> list[str]:
    """A statement an operation, entries in the brackets of "py" or "m" and counted as there."""
    words, first, lines = WORDS[language], int(language == "m"), []
    for k in range(function.n_instructions()):
        op, into = function.instruction_id(k), function.instruction_output(k)
        of = [f"w{i}" for i in function.instruction_input(k)]
        if op == ca.OP_OUTPUT:
            which, entry = into
            lines.append(f"{('dx', 'y')[which]}{words['at'].format(entry + first)} = {of[0]}")
            continue
        if op == ca.OP_INPUT:
            which, entry = function.instruction_input(k)
            value = "xu"[which] + words["at"].format(entry + first)
            text = words["number"].format(value)
        elif op == ca.OP_CONST:
            text = words["number"].format(float(function.instruction_constant(k)))
        elif op in UNARY or op in BINARY:
            text = (UNARY | BINARY)[op].format(*of, **words)
        else:
            name = next(n for n in dir(ca) if n.startswith("OP_") and getattr(ca, n) == op)
            raise ValueError(
                f"the structure uses {name[3:].lower()}, which has no form in text; write it by "
                "other functions"
            )
        lines.append(f"w{into[0]} = {text}")
    return lines
