"""Whether iterates are close to the end of a solve."""

import numpy as np
import pytest

from casid.shooting.newton import _Descent


@pytest.mark.parametrize("close", [False, True])
def test_the_same_iterate_gets_the_same_answer(close):
    # IPOPT may ask for the Hessian of one iterate twice: a step of zero is no sign of the end.
    descent = _Descent(1000, close)
    for x, cost in ((0.0, 9.0), (1.0, 5.0), (1.1, 4.0)):
        answers = [descent.close(np.array([x]), cost) for _ in range(3)]
        assert answers == [close] * 3
