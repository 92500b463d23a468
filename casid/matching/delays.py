"""Delays of a structure: those that are parameters, and those composed of several."""

import casadi as ca

from casid.free import Free


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
