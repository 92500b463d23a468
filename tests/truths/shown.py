"""One value of every kind that shows itself, small enough for every test."""

from functools import cache
from pathlib import Path

import numpy as np

from casid import (
    Distortion,
    HandlingBand,
    Identification,
    Model,
    Multistart,
    OrderSelection,
    Record,
    Rows,
    Scalar,
    StateSpace,
    bootstrap,
    compare_bounds,
    distances,
    frequency_response,
    handling_qualities,
    identifiability,
    inspect_records,
    kinematic_check,
    mode_bands,
    output_error,
    parameter,
    pbsid,
    profile_parameters,
    residuals,
    structure_error,
    transfer_function,
    validate,
)
from casid.logs.topics import Log, make_topic
from casid.subspace.candidates import Candidate

DT = 0.05
ORDERS = tuple(
    Candidate(order=n, past=20, pole=8.0, regularisation=0.01, score=score, error=0.1)
    for n, score in ((1, -2.0), (2, -4.5))
)
SHARES = np.array([1.0, np.nan, 3.0])[:, None, None]  # what noise explains [%]; ten times not


class Roll(Model):
    """Roll rate from the stick."""

    states = ("p",)
    inputs = ("lat",)
    outputs = ("p",)

    Lp: Scalar = parameter(default=-1.0, lower=-20.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=2.0, lower=0.0, upper=50.0, unit="rad/s^2")

    def A(self) -> Rows:
        return [[self.Lp]]

    def B(self) -> Rows:
        return [[self.Llat]]


TRUTH = StateSpace([[-2.5]], [[5.0]], [[1.0]], [[0.0]], None, ("lat",), ("p",))


def record(name="roll", seed=0, n=800):
    rng = np.random.default_rng(seed)
    u = 0.1 * np.repeat(rng.choice([-1.0, 1.0], size=n // 16 + 1), 16)[:n, None]
    t = DT * np.arange(n)
    y = TRUTH.simulate(t, u) + 0.01 * rng.standard_normal((n, 1))
    return Record(t, u, y, ("lat",), ("p",), name)


@cache
def values():
    """Name of each class, and a value."""
    flown = record()
    fit = output_error(Roll(), flown)
    box = pbsid(flown, order=1, pole=8.0)
    cases = {"free": {}, "held": {"Lp": "> -2"}}
    at = fit["Lp"].value + fit["Lp"].std_error * np.array([-3, 0, 3])
    found = [
        flown,
        frequency_response(flown),
        box,
        fit,
        validate({"output error": fit, "black box": box}, record("unseen", 1)),
        residuals(fit, flown),
        compare_bounds(Roll(), flown, cases=cases),
        profile_parameters(Roll(), flown, values={"Lp": at.tolist()}),
        bootstrap(fit, flown, runs=3, seed=0),
        distances(fit, box),
        structure_error(fit, box),
        TRUTH,
        box.excitation,
        handling_qualities(frequency_response(flown), ("p", "lat"), kind="rate"),
        transfer_function(frequency_response(flown), (0, 1)),
        mode_bands(fit)[0],
        HandlingBand(bandwidth=3.0, bandwidth_std=0.1, phase_delay=0.05, phase_delay_std=0.01),
        identifiability(Roll(), flown),
        kinematic_check(flown),
        inspect_records(flown),
        Identification(results={"pbsid": box, "output_error": fit}),
        Multistart(starts=(Roll(), Roll(Lp=-9.0)), costs=np.array([fit.cost, np.nan]),
                   reasons=("", "no way down"), fit=fit),
        OrderSelection(chosen=ORDERS[1], candidates=ORDERS, criterion="AICc",
                       singular_values=np.array([1.0, 0.1])),
        Distortion(omega=np.array([1.0, 2.0, 4.0]), inputs=("lat",), outputs=("p",),
                   small=np.array([0.1]), large=np.array([0.3]), noise=SHARES / 100,
                   distortion=SHARES / 10, excess=np.array([[9.0]]), together=np.array([[4.0]]),
                   least=np.array([[0.02]])),
        Log(path=Path("flight.ulg"), kind="PX4 ULog",
            topics={"gyro": make_topic("gyro", DT * np.arange(9.0), [("p", np.ones(9), "")])}),
    ]  # fmt: skip
    return {type(each).__name__: each for each in found}
