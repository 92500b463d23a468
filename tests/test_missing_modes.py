"""What a mode that a structure lacks is known to be."""

from types import SimpleNamespace

import numpy as np

from casid.missing_modes import _with_errors


def test_a_mode_of_a_black_box_without_errors_has_none():
    mode = _with_errors(-0.3 + 2j, SimpleNamespace(uncertainty=None))
    assert mode.pole == -0.3 + 2j
    assert np.isnan([mode.real_std, mode.imag_std]).all()
