"""Which attitude or velocity each rate and specific force is the derivative of."""

import numpy as np

from casid.consistency.instruments import OWN
from casid.consistency.measured import Flight
from casid.consistency.rigid import terms_of


def test_each_channel_enters_its_own_equation_level_and_at_rest_with_factor_one():
    values = dict.fromkeys(("u", "v", "w", "phi", "theta", "psi"), np.zeros(1))
    for name, equation in OWN.items():
        factors, _ = terms_of(equation, Flight(0.02, 0, values))
        assert factors[name][0] == 1
