"""Five samples of a roll: as small as a record may be in tests of what becomes of its samples."""

import numpy as np

from casid import Record

T = np.array([0.0, 0.1, 0.2, 0.3, 0.4])


def record(**changes):
    parts = {
        "t": T, "u": np.column_stack([T, -T]), "y": np.column_stack([2 * T, T**2, 1 + T]),
        "inputs": ("lat", "ped"), "outputs": ("p", "r", "phi"), "name": "roll",
    }  # fmt: skip
    return Record(**(parts | changes))
