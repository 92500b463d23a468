"""One model of a helicopter by its components over 40 to 80 kn, against a fit at each speed.

Records, noise, measures as in `benchmarks.envelope`; `MinimumComplexity` started from its defaults,
which its trims move to where they are in balance.

    OMP_NUM_THREADS=1 python -m benchmarks.components DATA [--kept FOLDER] [--seed N]

A fit in FOLDER is not made again.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.envelope import (
    BASE,
    CHANGES,
    ESTIMATOR,
    OUT,
    SEEN,
    SPEEDS,
    Flights,
    asked,
    balanced,
    changes,
    kept,
    local,
    unseen,
)  # fmt: skip
from benchmarks.tables import table
from benchmarks.uh60 import STEPS
from casid import Record
from casid.bounds.trials import aicc
from models.minimum_complexity import MinimumComplexity

# Known of any aircraft: gravity where it flies, rotors' tip speeds, twist, arms [m/s, rad, m],
# inertia.
KNOWN = {
    "g": 9.8146, "tip": 221.2, "tail_tip": 205.8, "twist": -0.105, "tail_twist": -0.137,
    "radius": 5.486, "hub": 1.516, "tail": 6.561, "tail_up": 0.8, "plane": 5.011,
    "plane_down": 1.123, "fin": 6.281, "fin_up": 1.054, "Iyx": 4.252, "Izx": 4.03,
    "gyration": 3.745,
}  # fmt: skip
INITIAL = {"v": (0.0, 0.1), "w": (1.4, 0.15)}  # m/s: level flight
# What records of one speed do not tell apart from the rest; the fit to three speeds does.
UNTOLD = (
    "lon_0", "Mthrust", "Nprofile", "Xuu", "tail_disk", "fin_0", "fin_stalled", "plane_0",
)  # fmt: skip
WIDTHS = 0.03, 0.005, 0.002  # rad, over which the fin stalls
COMPONENTS = replace(ESTIMATOR, interval=1.0, initial=INITIAL, steps=2)  # inflows lag little
FINE = replace(COMPONENTS, steps=4)  # for a tail rotor whose inflow hardly lags
AXES = ("u", "v", "w", "p", "q", "r")


def start(flights: Flights, speeds: Sequence[str]) -> MinimumComplexity:
    """The parameters nearest to the defaults with which the measured trims are balanced."""
    trims = [flights.trims[speed] for speed in speeds]
    middle = flights.trims[speeds[len(speeds) // 2]]
    trim = tuple(middle[name] for name in ("u", "theta", *MinimumComplexity.inputs))
    guess = MinimumComplexity(**KNOWN, trim=trim)
    low, high = np.array([(i.lower, i.upper) for i in guess.infos().values()]).T
    scale = np.maximum(0.2 * np.abs(guess.vector()), 1e-3 * (high - low))

    def moved(z: Any) -> MinimumComplexity:
        return guess.with_vector(np.clip(guess.vector() + scale * z, low, high))

    def residuals(z: Any) -> Any:
        return np.concatenate([z, *(100 * unbalanced(moved(z), each) for each in trims)])

    return moved(least_squares(residuals, np.zeros(len(scale))).x)


def unbalanced(model: MinimumComplexity, trim: dict[str, float]) -> Any:
    """Accelerations (6,) at a measured trim, its rotor settled."""
    x = balanced(model, trim)
    inputs = [trim[name] for name in model.inputs]
    f = model.equations()(list(x.values()), inputs, model.vector())[0]
    return f.full().ravel()[:6]


def fitted(flights: Flights, path: Path, speeds: Sequence[str]) -> Any:
    """The structure fitted to the 3-2-1-1 of some speeds.

    A fin that stalls sharply has more local minima: one that does so gently is fitted first, the
    lag of the tail rotor's inflow held, which would make up for it beyond what the steps stand.
    """
    records, guess = steps(flights, speeds), start(flights, speeds)
    for width in WIDTHS:
        guess = replace(guess, stall_width=width)
        held = ("tail_inflow",) if width == WIDTHS[0] else ()
        estimator = FINE if width == WIDTHS[-1] else COMPONENTS
        make = partial(estimator.fit, guess, records, fixed=held)
        fit = kept(path.with_stem(f"{path.stem}, {1e3 * width:g} mrad"), MinimumComplexity, make)
        guess = fit.model
    return fit


def having_seen(flights: Flights, path: Path, one: Any) -> Any:
    """The fit to three speeds, carried on with the changes of speed."""
    records = steps(flights, SPEEDS) + [flights.noisy("060kt", name) for name in CHANGES]
    return kept(path, MinimumComplexity, lambda: FINE.fit(one.model, records))


def own(flights: Flights, path: Path, speed: str, one: Any) -> Any:
    """The structure fitted to the 3-2-1-1 of one speed, from the fit to three."""
    records = steps(flights, [speed])
    return kept(path, MinimumComplexity, lambda: FINE.fit(one.model, records, fixed=UNTOLD))


def untrimmed(flights: Flights, one: Any) -> Any:
    """The structure fitted to three speeds with a constant in each equation of motion of a record.

    Then no trim binds it, nor anything tells a tilt of the shaft from one of the rotor.
    """
    estimator = replace(FINE, biases=("ax", "ay", "az"), state_biases=AXES)
    return estimator.fit(one.model, steps(flights, SPEEDS), fixed=("shaft",))


def steps(flights: Flights, speeds: Sequence[str]) -> list[Record]:
    """The noisy 3-2-1-1 of some speeds."""
    return [flights.noisy(speed, name) for speed in speeds for name in STEPS]


def with_errors(fit: Any, function: Callable[[Any], Any]) -> Any:
    """Values of a function of a model at a fit, their standard errors, and the ratios."""
    free = [fit.model.parameter_names().index(name) for name in fit.free_names]
    lam, f = fit.model.vector(), function(fit.model)
    step = 1e-3 * np.sqrt(np.diag(fit.covariance))
    moves = np.eye(len(lam))[free] * step[:, None]
    by = [(function(fit.model.with_vector(lam + each)) - f) for each in moves]
    J = np.array(by).T / step
    sigma = np.sqrt(np.diag(J @ fit.covariance @ J.T))
    return zip(f, sigma, f / sigma, strict=True)


def left_out(fit: Any, trim: dict[str, float]) -> Any:
    """How far a trim that no record was flown at is out of balance, over its standard errors."""
    found = with_errors(fit, lambda model: unbalanced(model, trim))
    rows = [(f"d{name}/dt", *each) for name, each in zip(AXES, found, strict=True)]
    return ("at the trim of 60 kn, left out", "out of balance", "its standard error", "ratio"), rows


def along(flights: Flights, fit: Any) -> Any:
    """What speed derivatives have beyond the trim curves, from a fit that no trim has bound."""
    rows = []
    for slow, fast in pairwise(SPEEDS):
        one, other = flights.trims[slow], flights.trims[fast]
        by_speed = unbalanced(fit.model, one | {"u": other["u"]}) - unbalanced(fit.model, one)
        found = with_errors(fit, partial(change, one=one, other=other))
        for name, speed, each in zip(AXES, by_speed, found, strict=True):
            rows.append((f"d{name}/dt, {slow} to {fast}", speed, *each))
    head = ("change by speed alone", "with the rest of the trims", "its standard error", "ratio")
    return ("trims not known", *head), rows


def change(model: MinimumComplexity, one: dict[str, float], other: dict[str, float]) -> Any:
    """Accelerations (6,) from one trim to another."""
    return unbalanced(model, other) - unbalanced(model, one)


def worth(flights: Flights, one: Any, alone: dict[str, Any]) -> Any:
    """Parameters and AICc of one model and of three."""
    total = sum(aicc(fit, steps(flights, [speed])) for speed, fit in alone.items())
    count = sum(len(fit.free_names) for fit in alone.values())
    whole = aicc(one, steps(flights, SPEEDS))
    rows = [("one model", len(one.free_names), f"{whole:.0f}")]
    return ("", "parameters", "AICc"), [*rows, ("three own fits", count, f"{total:.0f}")]


def main() -> None:
    flights, folder = asked(__doc__, "out/components")
    warnings.simplefilter("ignore")  # of speeds beyond the records
    near = {speed: local(flights, folder, speed) for speed in SPEEDS}
    paths = {case: folder / f"{case}.json" for case in (BASE, OUT, SEEN)}
    fits = {BASE: fitted(flights, paths[BASE], SPEEDS)}
    alone = {
        speed: own(flights, folder / f"own {speed}.json", speed, fits[BASE]) for speed in SPEEDS
    }
    print(f"\n{table(*worth(flights, fits[BASE], alone))}", flush=True)
    fits[OUT] = fitted(flights, paths[OUT], SPEEDS[::2])
    print(f"\n{table(*left_out(fits[OUT], flights.trims['060kt']))}", flush=True)
    print(f"\n{table(*unseen(flights, near, alone, fits, linear=False))}", flush=True)
    fits[SEEN] = having_seen(flights, paths[SEEN], fits[BASE])
    print(f"\n{table(*changes(flights, near, fits))}", flush=True)
    free = kept(
        folder / "no trim known.json", MinimumComplexity, lambda: untrimmed(flights, fits[BASE])
    )
    print(f"\n{table(*along(flights, free))}")


if __name__ == "__main__":
    main()
