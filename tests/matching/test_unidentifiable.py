"""What a target does not tell of a structure, against structures whose response says so."""

import numpy as np
import pytest

from casid import Constraint, DataWarning, Model, Scalar, StateSpace, match, parameter
from casid.free import free_parameters
from casid.matching.match import Match
from casid.matching.unidentifiable import untold

OMEGA = np.geomspace(0.1, 10, 30)
TRUTH = StateSpace(A=[[-2.0]], B=[[3.0]], C=[[1.0]], D=[[0.0]], delay=(), inputs=("u",),
                   outputs=("q",), states=("q",))  # fmt: skip


class Sum(Model):
    """Only the sum of two parameters is in the response, and of a last nothing."""

    states, inputs, outputs = ("q", "h"), ("u",), ("q",)
    a: Scalar = parameter(default=-1.0, lower=-10.0, upper=0.0, unit="1/s")
    b: Scalar = parameter(default=1.0, lower=-10.0, upper=10.0, unit="1/s")
    c: Scalar = parameter(default=1.0, lower=-10.0, upper=10.0, unit="1/s")
    h: Scalar = parameter(default=-1.0, lower=-10.0, upper=0.0, unit="1/s")

    def A(self):
        return [[self.a, 0], [1, self.h]]

    def B(self):
        return [[self.b + self.c], [0]]

    def C(self):
        return [[1, 0]]


class Tied(Sum):
    """The same, its two parts of one size."""

    def constraints(self):
        return (Constraint("alike", self.b - self.c),)


@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_a_match_names_what_its_target_does_not_tell(norm):
    with pytest.warns(DataWarning, match="the targets do not determine b, c: their values"):
        found = match(Sum(), TRUTH, norm=norm, omega=OMEGA, fixed={"h"})
    assert found["a"].value == pytest.approx(-2.0, abs=1e-4)
    assert found["b"].value + found["c"].value == pytest.approx(3.0, abs=1e-4)


@pytest.mark.parametrize(
    ("model", "known"),
    [
        (Sum(), {"fixed": ("c", "h")}),
        (Tied(), {"fixed": ("h",)}),
        (Sum(), {"fixed": ("h",), "priors": {"c": (1.0, 0.1)}}),
    ],
    ids=["held", "tied", "known before"],
)
def test_what_is_held_tied_or_known_is_not_named(model, known):
    free = free_parameters(model, known["fixed"], None, known.get("priors"))
    search = Match(norm="quadratic", omega=OMEGA)._search(free, (TRUTH,))
    none = np.zeros(len(free.index), dtype=bool)
    assert untold(free, search.comparison, free.guess, none) == ()


def test_one_frequency_tells_two_numbers():
    free = free_parameters(Sum(), ("h",))
    search = Match(norm="quadratic", omega=OMEGA[:1])._search(free, (TRUTH,))
    for active, named in (([False, True, False], ()), ([False] * 3, ("b", "c"))):
        assert untold(free, search.comparison, free.guess, np.array(active)) == named
