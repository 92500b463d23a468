"""Frozen values as JSON and as digests: what comes back, and what a digest tells apart."""

import ast
from dataclasses import dataclass, field, replace
from pathlib import Path

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import casid
from casid import OutputError, Record, SolverOptions
from casid.values import _HOMES, decode, digest, encode, seal, storable

ARRAYS = hnp.arrays(
    dtype=st.sampled_from([np.float64, np.int64, np.bool_]),
    shape=hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)


@given(ARRAYS)
def test_an_array_comes_back_as_it_was(array):
    back = decode(encode(array))
    assert back.dtype.kind == array.dtype.kind
    np.testing.assert_array_equal(back, array)


def test_complex_arrays_tuples_and_infinities_come_back_as_they_were():
    value = {"G": np.array([[1 + 2j, np.nan]]), "band": (0.5, np.inf), "names": ("a", ("b",))}
    back = decode(encode(value))
    np.testing.assert_array_equal(back["G"], value["G"])
    assert (back["band"], back["names"]) == (value["band"], value["names"])


def test_a_digest_changes_with_every_part_and_not_with_the_order_of_keys():
    assert digest({"a": 1, "b": 2.0}) == digest({"b": 2.0, "a": 1})
    assert digest({"a": 1}) != digest({"a": 2})
    assert digest(np.array([1.0, 2.0])) != digest(np.array([1.0, 2.5]))


def test_a_digest_tells_kinds_shapes_and_borders_apart():
    others = [
        np.zeros(4), np.zeros((2, 2)), np.zeros(4, dtype=int), [0.0] * 4, ("a", "b"), ("ab",),
        ("a", ("b",)), {"a": "b"}, 1, 1.0, True, "1", b"1", None, "",
    ]  # fmt: skip
    assert len({digest(each) for each in others}) == len(others)


def test_a_digest_of_a_record_sees_every_sample_name_and_the_hold():
    t = np.arange(5.0)
    record = Record(t, np.ones((5, 1)), np.ones((5, 2)), ("u",), ("x", "y"), "first")
    nudged = record.y.copy()
    nudged[3, 1] = np.nextafter(1.0, 2.0)
    others = [replace(record, y=nudged), replace(record, t=t + 1e-9), replace(record, hold="zoh"),
              replace(record, outputs=("x", "z")), replace(record, name="second")]  # fmt: skip
    assert len({digest(each) for each in (record, *others)}) == 6
    assert digest(replace(record)) == digest(record)


def test_the_digest_of_an_estimator_leaves_out_who_watches():
    watched = OutputError(solver=SolverOptions(progress=print))
    assert digest(watched) == digest(OutputError())
    assert digest(OutputError(solver=SolverOptions(tolerance=1e-6))) != digest(OutputError())


def test_what_has_no_content_has_no_digest():
    with pytest.raises(TypeError, match="has no digest"):
        digest({"task": print})


@storable
@dataclass(frozen=True, eq=False)
class Stored:
    values: np.ndarray
    more: tuple["Stored", ...] = ()
    names: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        seal(self)


def test_registered_values_come_back_whole_and_cannot_be_written():
    one = Stored(np.arange(3.0), (Stored(np.zeros((2, 0)), names={"a": np.inf}),))
    two = decode(encode(one))
    assert digest(two) == digest(one)
    assert two.more[0].names == {"a": np.inf}
    for each in (one, two):
        with pytest.raises(ValueError, match="read-only"):
            each.values[0] = 7.0


def test_other_values_come_back_only_where_they_are_allowed():
    @dataclass(frozen=True)
    class Private:
        x: float

    content = encode(Private(1.0))
    with pytest.raises(KeyError, match="Private"):
        decode(content)
    assert decode(content, (Private,)) == Private(1.0)


def test_a_name_stands_for_one_class():
    with pytest.raises(ValueError, match="files know 'Stored' as that of"):
        storable(type("Stored", (), {"__module__": "elsewhere"}))


@pytest.mark.second
def test_every_storable_class_is_found_where_it_is_defined():
    root = Path(casid.__file__).parent
    found = {}
    for path in root.rglob("*.py"):
        home = ".".join(path.relative_to(root).with_suffix("").parts)
        for node in ast.parse(path.read_text()).body:
            marks = getattr(node, "decorator_list", ())
            if any(isinstance(mark, ast.Name) and mark.id == "storable" for mark in marks):
                found.setdefault(home, set()).add(node.name)
    assert found == {home: set(names) for home, names in _HOMES.items()}
