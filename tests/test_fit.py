"""Fits: saved and read back alike, and a parameter table that says what pressed where."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from truths import closed_roll
from truths.structures import black_box

from casid import (
    Certificate,
    ConstraintEstimate,
    DataWarning,
    Fit,
    FrequencyResponse,
    MatchNotes,
    Model,
    ModelError,
    NonlinearModel,
    Rows,
    Scalar,
    derivid,
    match,
    output_error,
    parameter,
)
from casid.estimates import parameter_table
from casid.free import free_parameters
from casid.jobs.store import Done, Store
from casid.matching.appraisal import Peak
from casid.values import digest

OLD = Path(__file__).parent / "data" / "fit_0_1.json"
PEAK = Peak(source="box", omega=2.0, output="x", input="u")
NOTES = MatchNotes(start="guess", peak=PEAK, sources=())


class Lag(Model):
    states = ("x",)
    inputs = ("u",)
    outputs = ("x",)
    a: Scalar = parameter(default=-1.0, lower=-5.0, upper=0.0, unit="1/s")
    b: Scalar = parameter(default=2.0, unit="-")
    c: Scalar = parameter(default=0.5, lower=0.0, upper=1.0, unit="-")
    U0: float = 40.0

    def A(self) -> Rows:
        return [[self.a]]

    def B(self) -> Rows:
        return [[self.b * self.c]]


class Other(Lag):
    U1: float = 0.0


def table():
    free = free_parameters(Lag(c=0.25), fixed=("c",))
    return parameter_table(free, np.array([-5.0, 3.0]), np.array([0.7, 1e-9]), np.array([0.1, 0.2]))


def fit(**changes):
    parts = {
        "model": Lag(a=-5.0, b=3.0, c=0.25, U0=41.0), "parameters": table(), "cost": 1.5,
        "status": "solved", "success": True, "iterations": 7, "seconds": 0.25, "method": "test",
        "certificate": Certificate(
            grid_norm=0.1, upper_bound=np.inf, peak_omega=2.0, band=(0.5, 12.0), shift=0.2
        ),
        "covariance": np.array([[1.0, np.nan], [np.nan, 4.0]]), "free_names": ("a", "b"),
        "R": np.eye(1), "initial_states": np.zeros((2, 1)), "biases": np.ones((2, 1)),
        "interval": 1.0, "notes": NOTES, "held": 1,
        "constraints": (ConstraintEstimate(name="tie", value=0.1, lower=0.0, upper=np.inf,
                                           active=False, multiplier=0.0),),
    }  # fmt: skip
    return Fit(**(parts | changes))


def test_a_saved_fit_reads_back_the_same(tmp_path):
    one = fit()
    one.save(tmp_path / "fit.json")
    two = Fit.load(tmp_path / "fit.json", model=Lag)
    assert two.model == one.model
    assert two.model.U0 == 41.0  # the trim too
    for a, b in zip(one.parameters, two.parameters, strict=True):
        np.testing.assert_equal(b.__dict__, a.__dict__)  # NaN equals NaN, infinity infinity
    assert vars(two.certificate) == vars(one.certificate)
    for name in ("covariance", "R", "initial_states", "biases"):
        np.testing.assert_array_equal(getattr(two, name), getattr(one, name))
    for name in ("cost", "status", "success", "iterations", "seconds", "method", "interval"):
        assert getattr(two, name) == getattr(one, name)
    assert two.free_names == ("a", "b")
    assert two.notes.peak == one.notes.peak
    assert (two.held, two.constraints) == (1, one.constraints)


def test_a_file_of_version_0_1_is_read_without_its_notes():
    with pytest.warns(DataWarning, match=r"saved by casid 0\.1: its notes are left out"):
        old = Fit.load(OLD, model=Lag)
    new = fit()
    assert (old.model, old.constraints, old.held, old.notes) == (
        new.model, new.constraints, 1, None,
    )  # fmt: skip
    for a, b in zip(old.parameters, new.parameters, strict=True):
        np.testing.assert_equal(a.__dict__, b.__dict__ | {"cramer_rao": b.std_error})
    assert vars(old.certificate) == vars(new.certificate)
    np.testing.assert_array_equal(old.covariance, new.covariance)
    with pytest.raises(ModelError, match="it cannot be read as Other"):
        Fit.load(OLD, model=Other)


@pytest.mark.parametrize("name", ["covariance", "R", "initial_states", "biases"])
def test_the_arrays_of_a_fit_cannot_be_written(name, tmp_path):
    fit().save(tmp_path / "fit.json")
    for one in (fit(), Fit.load(tmp_path / "fit.json", model=Lag)):
        with pytest.raises(ValueError, match="read-only"):
            getattr(one, name)[0, 0] = 9.0


def test_what_a_fit_lacks_stays_absent(tmp_path):
    fit(certificate=None, covariance=None, R=None, cost=np.nan).save(tmp_path / "fit.json")
    again = Fit.load(tmp_path / "fit.json", model=Lag)
    assert (again.certificate, again.covariance, again.R) == (None, None, None)
    assert np.isnan(again.cost)


def test_the_fit_that_a_study_keeps_is_read_as_a_saved_one(tmp_path):
    Store(tmp_path).put("output_error", "key", Done(result=fit(), seconds=1.0))
    again = Fit.load(tmp_path / "output_error.json", model=Lag)
    assert digest(again) == digest(fit())
    kept = tmp_path / "output_error.json"
    content = json.loads(kept.read_text())
    content["result"]["fields"]["cost"] = 0.5
    kept.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"output_error\.json: changed after casid wrote it"):
        Fit.load(kept, model=Lag)


def unsealed(file):
    """What a saved fit holds, without the digest that tells any change: so were they before."""
    content = json.loads(file.read_text(encoding="utf-8"))
    del content["digest"]
    return content


def test_any_number_that_was_changed_in_a_saved_fit_is_told(tmp_path):
    file = tmp_path / "fit.json"
    fit(free_names=("a", "b"), covariance=np.diag([0.01, 0.04])).save(file)
    content = json.loads(file.read_text(encoding="utf-8"))
    file.write_text(json.dumps(content), encoding="utf-8")  # of another layout
    assert Fit.load(file, model=Lag).covariance[1, 1] == 0.04
    content["covariance"]["array"][1][1] = 0.02
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match=r"changed after casid wrote it.*estimate again"):
        Fit.load(file, model=Lag)


def test_a_fit_of_another_structure_or_no_fit_is_refused(tmp_path):
    file = tmp_path / "fit.json"
    fit().save(file)
    with pytest.raises(ModelError, match=r"holds a fit of Lag with a, b, c, U0; .* read as Other"):
        Fit.load(file, model=Other)
    content = unsealed(file)
    del content["cost"]
    file.write_text(json.dumps(content))
    with pytest.raises(ValueError, match="the saved fit has no 'cost'"):
        Fit.load(file, model=Lag)
    for damage, said in (
        (lambda row: row.update(active=None), r"a\.active = None is neither true nor false"),
        (lambda row: row.update(fixed=0), r"a\.fixed = 0 is neither"),
    ):
        fit().save(file)
        content = unsealed(file)
        damage(content["parameters"]["tuple"][0]["fields"])
        file.write_text(json.dumps(content))
        with pytest.raises(ValueError, match=said):
            Fit.load(file, model=Lag)
    content["covariance"]["array"] = 1.0
    file.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"fit\.json: covariance: an array of shape"):
        Fit.load(file, model=Lag)
    file.write_text('{"casid": "study"}')
    with pytest.raises(ValueError, match=r"fit\.json: not a fit saved by casid"):
        Fit.load(file, model=Lag)


def row_of(content, k=0):
    return content["parameters"]["tuple"][k]["fields"]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda x: row_of(x).update(value=7.0), "a is 7.0 in the table and not in the model"),
        (lambda x: x["model"]["fields"].update(a=7.0), "in the table and not in the model"),
        (lambda x: row_of(x).update(name="q"), "the table has q, b, c"),
        (lambda x: x["parameters"]["tuple"].pop(), "the table has a, b, not"),
        (lambda x: row_of(x).update(std_error=-1.0), "standard error of a is -1.0"),
        (lambda x: x.update(free_names={"tuple": ["a"]}), "shape .* for 1 free parameters"),
        (lambda x: x.update(free_names={"tuple": ["a", "q"]}), "a, q are not all parameters"),
        (lambda x: x.update(version=3), "version 3, where 1 and 2 are known"),
    ],
)
def test_a_file_edited_by_hand_is_refused_where_it_contradicts_itself(damage, said, tmp_path):
    file = tmp_path / "fit.json"
    whole = fit(free_names=("a", "b"), covariance=np.diag([0.01, 0.04]))
    whole.save(file)
    assert Fit.load(file, model=Lag).covariance.shape == (2, 2)
    content = unsealed(file)
    damage(content)
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match=said):
        Fit.load(file, model=Lag)


def test_an_iterate_that_ran_out_of_numbers_reads_back(tmp_path):
    lost = replace(fit().parameters[0], value=np.nan)
    model = Lag(a=np.nan, b=3.0, c=0.25, U0=41.0)
    fit(model=model, parameters=(lost, *fit().parameters[1:])).save(tmp_path / "fit.json")
    assert np.isnan(Fit.load(tmp_path / "fit.json", model=Lag).model.a)


def test_a_structure_whose_equations_are_others_by_now_is_refused(tmp_path):
    fit().save(tmp_path / "fit.json")

    class Changed(Lag):
        def B(self) -> Rows:
            return [[-entry for entry in row] for row in super().B()]

    Changed.__name__ = "Lag"
    with pytest.raises(ModelError, match="Lag has other B than when it was fitted"):
        Fit.load(tmp_path / "fit.json", model=Changed)


def test_a_structure_whose_channels_change_places_is_refused(tmp_path):
    class Pair(Lag):
        states, inputs, outputs = ("x", "y"), ("u", "v"), ("x", "y")

        def A(self) -> Rows:
            return [[self.a, 0], [0, self.a]]

        def B(self) -> Rows:
            return [[self.b, 0], [0, self.b]]

        def C(self) -> Rows:
            return [[1, 0], [0, 1]]

    values = {"a": -5.0, "b": 3.0, "c": 0.25, "U0": 41.0}
    fit(model=Pair(**values)).save(tmp_path / "fit.json")
    assert Fit.load(tmp_path / "fit.json", model=Pair).model.inputs == ("u", "v")
    for kind in ("states", "inputs", "outputs"):
        other = type("Pair", (Pair,), {kind: getattr(Pair, kind)[::-1]})
        with pytest.raises(ModelError, match=f"Pair has the {kind} ., .; when it was fitted they"):
            Fit.load(tmp_path / "fit.json", model=other)


@pytest.mark.parametrize("times", [1.0, 5.0])
def test_a_nonlinear_structure_of_other_equations_is_refused(tmp_path, times):
    # Both are the same at rest, the condition that they are linear models of.
    class Roll(NonlinearModel):
        states, inputs, outputs = ("p",), ("lat",), ("p",)
        d: Scalar = parameter(default=2.0, lower=0.0, upper=20.0, unit="1/rad")

        def derivatives(self, x, u):
            return [10 * u.lat - self.d * x.p * ca.fabs(x.p)]

    class Other(Roll):
        def derivatives(self, x, u):
            return [10 * u.lat - times * self.d * x.p * ca.fabs(x.p)]

    Other.__name__ = "Roll"
    row = replace(fit().parameters[0], name="d", value=3.0)
    fit(model=Roll(d=3.0), parameters=(row,), free_names=("d",), covariance=np.eye(1)).save(
        tmp_path / "fit.json"
    )
    if times == 1:
        assert Fit.load(tmp_path / "fit.json", model=Other).model.d == 3.0
        return
    with pytest.raises(ModelError, match="Roll has other dx/dt than when it was fitted"):
        Fit.load(tmp_path / "fit.json", model=Other)


def test_a_headline_says_how_many_parameters_are_on_their_bounds():
    rows, some = table(), {"model": Lag(), "method": "hand", "cost": 1.25, "free_names": ("a", "b")}
    some |= {"parameters": rows, "success": True, "status": ""}
    said = Fit.headline(SimpleNamespace(held=1, **some))
    assert said == "Lag by hand: solved, cost 1.25, 2 free parameters, 1 on their bounds"
    assert Fit.headline(SimpleNamespace(held=2, **some)) == f"{said}, 1 held by constraints"
    some |= {"parameters": rows[1:], "success": False, "status": "why"}
    said = Fit.headline(SimpleNamespace(held=0, **some))
    assert said == "Lag by hand: NOT SOLVED (why), cost 1.25, 2 free parameters"


def test_rows_are_found_by_name():
    assert fit()["b"].value == 3.0
    with pytest.raises(KeyError, match="no parameter 'q'; the model has a, b, c"):
        fit()["q"]
    assert replace(fit(), success=False).success is False


def test_a_file_says_its_kind_and_version(tmp_path):
    fit().save(tmp_path / "fit.json")
    content = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert (content["casid"], content["version"]) == ("fit", 2)


@pytest.mark.slow
def test_a_process_that_has_imported_nothing_reads_the_fits_of_every_estimator(tmp_path):
    truth = closed_roll.Roll()
    omega = np.geomspace(0.3, 12.0, 20)
    G = truth.system().response(omega)
    measured = FrequencyResponse(
        omega=omega,
        G=G,
        coherence=np.ones(G.shape),
        random_error=np.full(G.shape, 0.01),
        inputs=truth.inputs,
        outputs=truth.outputs,
        input_std=np.ones(2),
        output_std=np.ones(3),
    )
    fits = {
        "output_error": output_error(truth, closed_roll.noisy()),
        "match": match(truth, black_box(truth.system()), norm="hinf"),
        "derivid": derivid(truth, measured, starts=1),
    }
    for name, fit in fits.items():
        fit.save(tmp_path / f"{name}.json")
        code = (
            "from casid import Fit; from truths.closed_roll import Roll; "
            f"print(type(Fit.load({str(tmp_path / name)!r} + '.json', model=Roll).notes).__name__)"
        )
        run = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=False,
            cwd=Path(__file__).parent,
        )
        assert run.stdout.strip() == type(fit.notes).__name__, run.stderr
