"""Running integrals, against closed forms."""

import numpy as np
import pytest

from casid.consistency.flightpath import _integral


def test_running_integrals_are_exact_for_straight_lines_and_of_fourth_order_inside():
    t = np.linspace(0.0, 2.0, 41)
    line = _integral(np.column_stack([np.ones(41), 3 - 2 * t]), 0.05)
    np.testing.assert_allclose(line, np.column_stack([t, 3 * t - t**2]), atol=1e-13)
    errors = []
    for count in (41, 81):
        t = np.linspace(0.0, 2.0, count)
        found = _integral(np.sin(3 * t)[:, None], t[1])[:, 0]
        inside = found - found[1] - (np.cos(3 * t[1]) - np.cos(3 * t)) / 3
        errors.append(np.abs(inside[1:-1]).max())
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.2)
