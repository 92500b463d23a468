"""Whatever estimates has one shape."""

import dataclasses
import inspect

import pytest

from casid import Chain, Derivid, Match, OutputError
from casid.estimator import Estimator

SHAPE = inspect.signature(Estimator.fit)


@pytest.mark.parametrize("kind", [Chain, Derivid, Match, OutputError])
def test_an_estimator_is_a_frozen_value_that_fits_like_all_others(kind):
    own = inspect.signature(kind.fit)
    assert [(p.name, p.kind) for p in own.parameters.values()] == [
        (p.name, p.kind) for p in SHAPE.parameters.values()
    ]
    assert all(
        own.parameters[name].default == SHAPE.parameters[name].default
        for name in ("fixed", "bounds", "near")
    )
    assert dataclasses.is_dataclass(kind)
    made = kind()
    name = dataclasses.fields(kind)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(made, name, None)
    with pytest.raises(TypeError):  # settings have names
        kind(None)
