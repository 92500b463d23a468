"""Where inputs of a record move and all its outputs rest: nothing flies there."""

import numpy as np

from casid.record import Record

WINDOW = 2.0  # s in which inputs that move are to be answered
STILL = 0.02  # of its deviation over the record, below which an output rests
MOVING = 0.5  # of an input's deviation, above which it moves


def unanswered(record: Record) -> list[tuple[str, float, float]]:
    """Where inputs move and all outputs rest, for a window or longer; name, from and to [s].

    Outputs that are missing (NaN) in most of a window do not rest there: nobody knows.
    """
    n = max(8, round(WINDOW / record.dt))
    outputs = np.ma.masked_invalid(record.y)
    rest, move = STILL * outputs.std(axis=0), MOVING * record.u.std(axis=0)
    found: list[tuple[str, float, float]] = []
    for a in range(0, record.N - n + 1, n):
        u, y = record.u[a : a + n], outputs[a : a + n]
        measured = np.flatnonzero(~np.ma.getmaskarray(y).all(axis=1))
        if len(measured) == 0 or np.ptp(measured) < n // 2:
            continue
        if (y.std(axis=0) > rest).filled(False).any() or not (u.std(axis=0) > move).any():
            continue
        start, end = float(record.t[a]), float(record.t[a + n - 1])
        if found and start - found[-1][2] < 2 * record.dt:
            start = found.pop()[1]
        found.append((record.name, start, end))
    return found
