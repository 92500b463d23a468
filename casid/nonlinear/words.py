"""A nonlinear structure in words: its equations, its reference condition, what is not smooth."""

import casadi as ca

from casid.nonlinear.expressions import operations
from casid.nonlinear.model import NonlinearModel


def equations_text(model: NonlinearModel) -> str:
    """Equations with names, the reference condition and dx/dt there, operations with kinks."""
    x, u, lam = (
        ca.vertcat(*map(ca.SX.sym, names))
        for names in (model.states, model.inputs, model.parameter_names())
    )
    f, h = model.equations()(x, u, lam)
    named = [f"d{name}/dt" for name in model.states], [f"{name} measured" for name in model.outputs]
    lines, kinks = ["equations, total values"], []
    for names, column in zip(named, (f, h), strict=True):
        for name, value in zip(names, ca.vertsplit(column), strict=True):
            lines.append(f"  {name} = {value}")
            kinks += [f"{name} ({used})" for used in operations(value)]
    x0, u0 = model.operating_point()
    rates = model.equations()(x0, u0, model.vector())[0].full().ravel()
    lines += ["", "reference condition, where the linearisation below holds"]
    lines += [
        f"  {name} = {at:.4g}" + f" {model.units.get(name, '')}".rstrip() + f", d/dt {rate:.3g}"
        for name, at, rate in zip(model.states, x0, rates, strict=True)
    ]
    lines += [f"  {name} = {at:.4g}" for name, at in zip(model.inputs, u0, strict=True)]
    if kinks:
        lines += ["", "slopes that may jump: " + ", ".join(kinks)]
    return "\n".join(lines)
