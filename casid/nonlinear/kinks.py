"""Conditions on a jump or a kink of the equations, where a derivative is neither side's."""

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.nonlinear.expressions import KINKS, Nonlinear, operations

KINK = 1e-6  # change of a slope, over the largest of its equation, that is more than rounding
ASIDE = 1e-6, 1e-9  # of a condition, over its channels or 1: what stays between is no curvature


def kinks(model: Nonlinear, x: Array, u: Array) -> list[str]:
    """In words, equations that jump or have two slopes at states (nx,) and inputs (nu,)."""
    equations, channels = model.equations(), (*model.states, *model.inputs)
    z, lam = ca.SX.sym("z", len(channels)), ca.DM(model.vector())
    both = ca.vertcat(*equations(z[: len(x)], z[len(x) :], lam))
    if not set(operations(both)) & {*KINKS.values()}:
        return []
    function, at = ca.Function("beside", [z], [both, ca.jacobian(both, z)]), np.concatenate([x, u])
    names, found = (*(f"d{each}/dt" for each in model.states), *model.outputs), []
    for i, (name, value) in enumerate(zip(channels, at.tolist(), strict=True)):
        far, near = (_sides(function, at, i, size * max(1.0, abs(value))) for size in ASIDE)
        (y, dy), (J, dJ) = ((part[0], np.abs(part[1] - part[0])) for part in near)
        stays = [2 * d > np.abs(f[1] - f[0]) for d, f in zip((dy, dJ), far, strict=True)]
        jumps = stays[0] & (2 * dy > ASIDE[1] * np.maximum(1.0, np.abs(y)))
        largest = np.abs(np.array(near[1])).max(axis=(0, 2))
        bends = np.where(stays[1] & (dJ > KINK * largest[:, None]), dJ, 0.0)
        for k, equation in enumerate(names):
            by = int(np.argmax(bends[k]))
            if jumps[k]:
                found.append(f"{equation} jumps at {name} = {value:.4g}")
            elif bends[k, by]:
                found.append(
                    f"{equation} has a slope by {channels[by]} of {J[k, by]:.3g} below and of "
                    f"{near[1][1][k, by]:.3g} above {name} = {value:.4g}"
                )
    return found


def _sides(function: ca.Function, at: Array, i: int, off: float) -> tuple[list[Array], list[Array]]:
    """Values (m,) and slopes (m, n) of a function, below and above a point (n,) along one axis."""
    step = off * np.eye(len(at))[i]
    below, above = (function(at + way * step) for way in (-1.0, 1.0))
    return [s[0].full().ravel() for s in (below, above)], [s[1].full() for s in (below, above)]
