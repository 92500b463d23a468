"""A system and a record to hand to other tools."""

import numpy as np
import pytest

from casid import Record, StateSpace


@pytest.fixture
def system():
    rng = np.random.default_rng(4)
    A = rng.standard_normal((3, 3)) - 2 * np.eye(3)
    B, C, D = (rng.standard_normal(shape) for shape in ((3, 2), (2, 3), (2, 2)))
    return StateSpace(A, B, C, D, None, ("lat", "ped"), ("p", "r"), ("a", "b", "c"))


@pytest.fixture
def record():
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.01, 0.03, 50))
    y = rng.standard_normal((50, 2))
    y[7, 1] = np.nan
    u = rng.standard_normal((50, 1))
    raw = Record(t, u, y, ("lat",), ("p", "phi"), "a flight", "zoh")
    return raw.detrend({"lat": 0.5, "p": 0.01, "phi": -0.02})
