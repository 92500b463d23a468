"""How far the approximation of a sensor's delay follows inputs that step.

An output that feels an input at once steps with it, later by its sensor's delay. The Padé
approximation P of that delay (`casid.sensors`) rounds what is fast against it: it is off by

    D (P − e^(−τs)) u,

whatever else the output is of. In standard deviations of the noise, all samples together, this is
the most that it can move any combination of parameters by, in standard errors.
"""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.errors import warn
from casid.fit import AnyFit
from casid.linear import StateSpace
from casid.model import Model
from casid.record import Record
from casid.sensors import late_states

MUCH = 5.0  # standard deviations, of all samples together: estimates move by some fraction of it


def warn_rounded(fit: AnyFit, records: Sequence[Record]) -> None:
    """Tell late outputs whose steps the approximation of their delay rounds."""
    noise = np.sqrt(np.diag(np.asarray(fit.R)))
    for name in fit.model.late_outputs:
        each = noise[fit.model.outputs.index(name)]
        off = np.concatenate([rounded(fit.model, name, record) for record in records])
        size = float(np.sqrt(np.nansum(off**2))) / each
        if size > MUCH:
            warn(
                f"{name} responds to steps of the inputs at once, and the approximation of its "
                f"sensor's delay smooths these by up to {np.nanmax(np.abs(off)):.2g}, with noise "
                f"of {each:.2g}: estimates may be several standard errors off. Where the delay "
                f"is known, move the channel (Record.shift) and leave {name} out of late_outputs"
            )


def rounded(model: Model, name: str, record: Record) -> Array:
    """By how much the approximated delay of an output is off in a record, (N,); NaN where lost."""
    system, delay = model.system(), float(model.sensors()[name].delay)
    late = [model.states.index(state) for state in late_states(name)]
    if not system.B[late].any():
        return np.zeros(record.N)
    A, C = system.A[np.ix_(late, late)], system.C[[model.outputs.index(name)]][:, late]
    direct, none = -C @ np.linalg.solve(A, system.B[late]), np.zeros((1, record.nu))
    rounds = StateSpace(A, system.B[late], C, none, delay=system.delay)
    exact = StateSpace(-np.eye(1), none, np.zeros((1, 1)), direct, delay=system.delay + delay)
    u = record.u - record.u[0]
    one, other = (each.simulate(record.t, u, hold=record.hold) for each in (rounds, exact))
    lost = np.isnan(record.channel(name))
    return np.where(lost, np.nan, (one - other)[:, 0])
