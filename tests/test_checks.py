"""Every public function names the argument that is wrong, what was wanted and what to do."""

import inspect
import pickle
from collections.abc import Callable, Collection, Mapping
from types import NoneType, UnionType
from typing import Any, Literal, Protocol, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from truths.closed_roll import Roll, flown

import casid
from casid import Fit, Match, Model, OutputError, Pbsid, SpectralAnalysis, StateSpace
from casid.checks import fits, hint
from casid.stages.sufficiency import Sufficiency

WORDS_OF_A_STRUCTURE = {"parameter", "matrix", "spline"}
FUNCTIONS = [
    name
    for name in sorted(casid.__all__)
    if inspect.isfunction(getattr(casid, name)) and name not in WORDS_OF_A_STRUCTURE
]


def some(hint):
    """Something that an annotation takes, of which nothing else is asked."""
    hint = hint.__bound__ if isinstance(hint, TypeVar) else hint
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in {Union, UnionType}:
        return some(inner[0])
    if kind is tuple:
        return tuple(some(each) for each in inner if each is not Ellipsis)
    made = {
        Any: None, Literal: (inner or [None])[0], str: "x", int: 1, float: 1.0, bool: True,
        NoneType: None, np.ndarray: np.ones(2), Model: Roll(), type: Roll,
    }  # fmt: skip
    if kind in made:
        return made[kind]
    if issubclass(kind, Collection) and inner:
        return {} if issubclass(kind, Mapping) else []
    if issubclass(kind, Protocol) or getattr(kind, "_is_protocol", False):
        return OutputError()
    return object.__new__(kind)


def arguments():
    for name in FUNCTIONS:
        function = inspect.unwrap(getattr(casid, name))
        hints = get_type_hints(function)
        for parameter in inspect.signature(function).parameters:
            if parameter in hints and not fits(object(), hints[parameter]):
                yield name, parameter


@pytest.mark.parametrize(("name", "parameter"), list(arguments()))
def test_an_argument_of_no_kind_that_is_wanted_is_named(name, parameter):
    function = getattr(casid, name)
    parameters, hints = inspect.signature(function).parameters, get_type_hints(function)
    given = {
        each: some(hints.get(each, Any))
        for each, it in parameters.items()
        if it.default is it.empty
    }
    with pytest.raises(ValueError, match=rf"^{name}: {parameter} = an object, expected \S"):
        function(**(given | {parameter: object()}))


ROLL, PLANT = Roll(), Roll().system()
RECORD = flown(t=0.02 * np.arange(400), seed=1)
REFUSED = [
    (lambda: casid.match(PLANT, ROLL), "match: model = a StateSpace, .*; swap model and target"),
    (lambda: casid.output_error([RECORD], ROLL), "expected Model; swap model and records"),
    (lambda: casid.validate([RECORD], {"a": ROLL}), "swap models and records"),
    (lambda: casid.validate(ROLL, RECORD), 'models = a Roll, .*give it a name: {"name": ...}'),
    (lambda: casid.match(Roll, PLANT), r"the class Roll, expected Model; make one: Roll\(\)"),
    (lambda: casid.match(ROLL, PLANT, omega=[]), r"match: omega = \[\], expected one freq"),
    (lambda: casid.match(ROLL, PLANT, fixed="Lp"), r"fixed = 'Lp', expected texts; write \['Lp'\]"),
    (lambda: casid.match(ROLL, PLANT, bounds={"Lp": 1}), "{a text: .a number, a number.}"),
    (lambda: casid.frequency_response(RECORD, omega=[]), "expected one frequency at least"),
    (lambda: casid.frequency_response(RECORD, omega=[-1.0]), "omega: .* frequencies above 0"),
    (lambda: casid.frequency_response(RECORD, windows=20.0), r"expected numbers; write \[20.0\]"),
    (lambda: casid.derivid(ROLL, [], band=[1]), r"band = \[1\], expected \(a number, a number\)"),
    (lambda: casid.derivid(ROLL, [], band=(2.0, 1.0)), r"band = .*, expected \(lowest, highest\)"),
    (
        lambda: casid.profile_parameters(ROLL, [RECORD], values={"Lp": -3.0}),
        "expected a mapping {a text: numbers}",
    ),
    (
        lambda: casid.profile_parameters(ROLL, [RECORD], values={"Lp": [1.0]}, level=95),
        "level=95: expected a confidence between 0 and 1",
    ),
    (
        lambda: Sufficiency(level=0.95),
        "level=0.95: expected the chance of a false alarm, above 0 and at most 0.5, such as 0.01",
    ),
    (
        lambda: casid.compare_bounds(ROLL, [RECORD], cases=["free"], validation=RECORD),
        r"cases = \['free'\], expected a mapping",
    ),
    (lambda: casid.validate({"a": ROLL}, RECORD, horizon=np.nan), "horizon = nan, expected a num"),
    (lambda: casid.validate({"a": ROLL}, RECORD, horizon=-1.0), "horizon = -1.0, expected numbers"),
    (
        lambda: casid.read_frequency_csv("x", pairs={("p", "lat"): "p_lat"}),
        r'write \(output, input\): \(gain, phase, ...\), .*\("p_lat_dB", "p_lat_deg"\)}; pairs_of',
    ),
    (lambda: casid.read_frequency_csv("x", pairs=["p_lat"]), r"pairs = \['p_lat'\], .* pairs_of"),
    (lambda: casid.pbsid(RECORD, order=2.5), "order = 2.5, expected a whole number"),
    (lambda: casid.pbsid(RECORD, order=True), "order = True, expected a whole number"),
    (lambda: casid.pbsid(RECORD, regularisation=-1), "regularisation = -1, expected 0 or more"),
    (lambda: casid.read_csv("x", inputs="lat", outputs=["p"]), r"write \['lat'\]"),
    (lambda: Fit.load("x.json", model=ROLL), "model = a Roll, expected a class; pass Roll itself"),
    (lambda: Pbsid(order=2.5), "Pbsid: order = 2.5, expected a whole number"),
    (lambda: Match(omega=[]), r"Match: omega = \[\], expected one frequency"),
    (lambda: casid.output_error(ROLL, RECORD, interval=-1.0), "interval=-1.0: expected sec"),
    (lambda: casid.match(ROLL, PLANT, omega="all"), "omega = 'all', expected an array of numbers$"),
    (lambda: OutputError(priors={"Lp": 1.0}), "priors = .*: .a number, a number.}"),
    (lambda: SpectralAnalysis(windows=["a"]), "SpectralAnalysis: windows = .*, expected numbers"),
    (lambda: RECORD.decimate(2.5), "Record.decimate: step = 2.5, expected a whole number"),
    (lambda: RECORD.mask(np.ones(3, dtype=bool)), r"where has shape \(3,\), expected \(N, ny\)"),
    (lambda: RECORD.shift(0.1), "Record.shift: by = 0.1, expected a mapping"),
    (lambda: RECORD.select(inputs="lat"), r"Record.select: .*; write \['lat'\]"),
    (lambda: RECORD.cut("a", 3.0), "Record.cut: start = 'a', expected a number"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[each[1][:40] for each in REFUSED])
def test_what_is_refused_says_what_was_wanted_and_what_to_do(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    ("value", "hint", "fitting"),
    [
        (1, float, True), (np.float32(1), float, True), (np.nan, float, False),
        (True, int, False), (np.int64(3), int, True), (3.0, int, False),
        (np.True_, bool, True), (1, bool, False), ("ab", list[str], False),
        (["ab"], tuple[str, ...], True), ((1.0, 2), tuple[float, float], True),
        ((1.0,), tuple[float, float], False), ({"a": 1}, Mapping[str, float], True),
        ({"a": "b"}, Mapping[str, float], False), ([[1, 2], [3]], np.ndarray, False),
        ([[1, 2]], np.ndarray, True), ("one", Literal["one", "two"], True),
        ("three", Literal["one", "two"], False), (None, int | None, True),
        (len, Callable[[int], int], True), (3, Callable[[int], int], False),
        (Roll, type[Model], True), (StateSpace, type[Model], False), (3, Any, True),
    ],
)  # fmt: skip
def test_values_fit_annotations(value, hint, fitting):
    assert fits(value, hint) is fitting


def test_public_functions_are_found_again_by_processes():
    assert pickle.loads(pickle.dumps(casid.output_error)) is casid.output_error
    assert inspect.signature(casid.pbsid).parameters["order"].default is None


def test_an_argument_too_many_or_missing_is_told_with_the_function_and_what_it_takes():
    with pytest.raises(
        TypeError, match=r"^residuals: missing a required.*'records'; it takes \(mo"
    ):
        casid.residuals(Roll())


def test_a_hint_names_the_nearest_and_then_all():
    assert hint("ordre", ["order", "past"]) == "did you mean 'order'? Known are order, past"
    assert hint("zzz", ["order", "past", "order"]) == "known are order, past"
    assert hint("order", []) == "there are none"


def test_a_misspelt_word_is_told_the_one_that_was_meant():
    with pytest.raises(ValueError, match=r"method = 'multisin', .*; did you mean 'multisine'\?"):
        casid.DesignSettings(method="multisin")
