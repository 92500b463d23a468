"""Delays of a structure, kept at zero or more: by bounds, or by constraints where composed."""

from dataclasses import replace

import casadi as ca
import numpy as np

from casid.errors import ModelError
from casid.model import Free


def delay_parameters(free: Free) -> tuple[list[int], list[int]]:
    """Free parameters that are a delay themselves, and inputs whose delay is composed of others."""
    lam = ca.SX.sym("lam", len(free.index))
    slope = ca.jacobian(free.model.matrices()(free.full(lam))[4], lam)
    bare, composed = [], []
    for j in range(slope.shape[0]):
        row = slope[j, :]
        which = row.sparsity().get_triplet()[1]
        if len(which) == 1 and row[0, which[0]].is_one():
            bare.append(int(which[0]))
        elif row.nnz():
            composed.append(j)
    return bare, composed


def with_nonnegative_delays(free: Free) -> Free:
    """The same with lower bounds of at least zero on parameters that are a delay themselves."""
    lower, at = free.lower.copy(), free.index[delay_parameters(free)[0]]
    lower[at] = np.maximum(lower[at], 0.0)
    if (bad := np.flatnonzero(lower > free.upper)).size:
        name = free.model.parameter_names()[bad[0]]
        raise ModelError(f"{name} is a delay with upper bound {free.upper[bad[0]]:g} < 0; raise it")
    return replace(free, lower=lower)
