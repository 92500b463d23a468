"""One scheduled model of a helicopter over 40 to 80 kn, against a fit at each speed.

Records are those of heli-gym's AW109 (folders 040kt, 060kt, 080kt of DATA) at 25 Hz, noise added,
an airspeed of 0.5 m/s among it: the four 3-2-1-1 at each speed, `ScheduledSixDof` started from
local fits of `SixDof` to the same records. "Own" are fits of the same class to the records of one
speed. Errors are those of simulations, or predictions 3 s ahead, of noise-free records that no fit
has seen, geometric means over the outputs of their ratio to another's.

    OMP_NUM_THREADS=1 python -m benchmarks.envelope DATA [--kept FOLDER] [--seed N]

A fit in FOLDER is not made again.
"""

import argparse
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables import table
from benchmarks.uh60 import INPUTS, NOISE, OUTPUTS, STEPS
from casid import (
    ConvergenceError,
    Fit,
    OutputError,
    Record,
    Scalar,
    Trim,
    output_error,
    parameter,
    read_csv,
    validate,
)
from casid.bounds.trials import aicc
from models.scheduled_six_dof import CURVES, ScheduledSixDof
from models.six_dof import SixDof

SPEEDS = ("040kt", "060kt", "080kt")
UNSEEN = ("validation_random", "validation_large")
CHANGES = ("accelerate", "decelerate")
AHEAD = 3.0  # s, of predictions: the phugoid is unstable
BASE, OUT = "three speeds", "without 60 kn"
SIX, SIX_OUT = "three speeds, no attitude", "without 60 kn, no attitude"
FREED, SEEN = "speed derivatives free", "with changes of speed"
ATTITUDE = ("Ltheta", "Ltheta_V", "Ntheta", "Ntheta_V")
SPEED_NOISE = 0.5  # m/s
BENT = tuple(f"{n}_VV" for n in ("Zw", "Zcol", "Mw", "Mq", "Mcol", "Mlon", "Nv", "Nr", "Nped"))
TRIMS = tuple(f"{axis}trim" for axis in "XYZLMN")
HELD = ScheduledSixDof.balance
# Speeds of a fit, what it holds, manoeuvres at 60 kn beside the 3-2-1-1.
CASES = {
    SIX: (SPEEDS, (*HELD, *ATTITUDE), ()),
    SIX_OUT: (SPEEDS[::2], (*HELD, *BENT, *ATTITUDE), ()),
    BASE: (SPEEDS, HELD, ()),
    OUT: (SPEEDS[::2], (*HELD, *BENT), ()),
    FREED: (SPEEDS, TRIMS, ()),
    SEEN: (SPEEDS, HELD, CHANGES),
}


class Flown(ScheduledSixDof):
    """With a measured airspeed, some derivatives parabolas over speed, moments by pitch attitude.

    These are no aerodynamics: the inflow of this simulation's tail rotor depends on the attitude.
    """

    outputs = (*ScheduledSixDof.outputs, "u")

    Zw_VV: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Zcol_VV: Scalar = parameter(default=0.0, lower=-50, upper=50, unit="m/s^2")
    Mw_VV: Scalar = parameter(default=0.0, lower=-0.2, upper=0.2, unit="rad/(m s)")
    Mq_VV: Scalar = parameter(default=0.0, lower=-2, upper=2, unit="1/s")
    Mcol_VV: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="rad/s^2")
    Mlon_VV: Scalar = parameter(default=0.0, lower=-10, upper=10, unit="rad/s^2")
    Nv_VV: Scalar = parameter(default=0.0, lower=-0.2, upper=0.2, unit="rad/(m s)")
    Nr_VV: Scalar = parameter(default=0.0, lower=-1, upper=1, unit="1/s")
    Nped_VV: Scalar = parameter(default=0.0, lower=-10, upper=10, unit="rad/s^2")

    Ltheta: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="1/s^2")
    Ltheta_V: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="1/s^2")
    Ntheta: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="1/s^2")
    Ntheta_V: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="1/s^2")

    def measurements(self, x: Any, u: Any) -> Sequence[Any]:
        return [*ScheduledSixDof.measurements(self, x, u), x.u]


def bent() -> type[Flown]:
    """The structure with all derivatives parabolas over speed."""
    infos, body = Flown(U0=30.0).infos(), {}
    for name in (*SixDof.parameter_names(), "Ltheta", "Ntheta"):
        if name in infos and name not in HELD and not name.startswith("tau"):
            wide = max(abs(infos[name].lower), abs(infos[name].upper)) / 2
            for own in (f"{name}_V", f"{name}_VV"):
                if own not in infos:
                    unit = infos[name].unit
                    body[own] = parameter(default=0.0, lower=-wide, upper=wide, unit=unit)
    notes = {"__annotations__": dict.fromkeys(body, Scalar), "__module__": __name__}
    return type("Parabolas", (Flown,), {**notes, **body, "__qualname__": "Parabolas"})


class Flights:
    """The records of a folder, with noise of a seed."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder, seed
        self.trims = {speed: self._trim(speed) for speed in SPEEDS}

    def read(self, speed: str, name: str, outputs: Sequence[str] = OUTPUTS) -> Record:
        """One record, noise-free, total values, 25 Hz."""
        units = dict.fromkeys(INPUTS, "%")
        record = read_csv(
            self.folder / speed / f"{name}.csv", inputs=INPUTS, outputs=outputs, units=units
        )
        return record.decimate(2)

    def noisy(self, speed: str, name: str) -> Record:
        """One record of an estimation, which measures u, too."""
        number = [self.seed, int(speed[:3]), *name.encode()]
        sizes = NOISE | {"u": SPEED_NOISE}
        rng = np.random.default_rng(number)
        return self.read(speed, name, (*OUTPUTS, "u")).with_noise(sizes, rng)

    def deviations(
        self, speed: str, name: str, *, noisy: bool = False, outputs: Sequence[str] = OUTPUTS
    ) -> Record:
        """One record from the trim of its speed."""
        record = self.noisy(speed, name) if noisy else self.read(speed, name, (*OUTPUTS, "u"))
        return record.detrend(self.trims[speed]).select(outputs=outputs)

    def _trim(self, speed: str) -> dict[str, float]:
        still = self.read(speed, STEPS[0], (*OUTPUTS, "u", "v", "w")).cut(0.0, 1.9)
        return {name: float(values.mean()) for name, values in still.totals().items()}

    def structure(self, speeds: Sequence[str]) -> Flown:
        """The scheduled structure with the trims of some speeds."""
        trims = [self.trims[speed] for speed in speeds]
        curves = tuple(tuple(trim[name] for trim in trims) for name in CURVES)
        return Flown(
            U0=self.trims["060kt"]["u"], speeds=tuple(trim["u"] for trim in trims), curves=curves
        )


def kept(path: Path, structure: type, make: Callable[[], Any]) -> Any:
    """The fit in a file, or a new one, not converged perhaps."""
    if path.exists():
        return Fit.load(path, model=structure)
    begin = time.process_time()
    try:
        fit = make()
    except ConvergenceError as error:
        fit = error.best
    print(f"{path.stem}: {fit.status}, {time.process_time() - begin:.0f} s", flush=True)
    fit.save(path)
    return fit


def local(flights: Flights, folder: Path, speed: str) -> Any:
    """`SixDof` fitted to the four 3-2-1-1 of a speed."""
    trim = flights.trims[speed]
    names = {"U0": "u", "V0": "v", "W0": "w", "phi0": "phi", "theta0": "theta"}
    start = SixDof(Mlon=-4.0, Nped=-2.5, **{key: trim[name] for key, name in names.items()})
    records = [flights.deviations(speed, name, noisy=True) for name in STEPS]
    return kept(folder / f"{speed}.json", SixDof, lambda: output_error(start, records))


def scheduled(flights: Flights, folder: Path, case: str, near: dict[str, Any]) -> Any:
    """The scheduled structure fitted to the records of a case, from local fits."""
    speeds, fixed, more = CASES[case]
    records = [flights.noisy(speed, name) for speed in speeds for name in STEPS]
    records += [flights.noisy("060kt", name) for name in more]
    start = along_speed(flights.structure(speeds), [near[speed].model for speed in speeds])
    estimator = OutputError(interval=2.0, biases=False, steps=1)
    return kept(folder / f"{case}.json", Flown, lambda: estimator.fit(start, records, fixed=fixed))


def own(flights: Flights, folder: Path, speed: str, near: dict[str, Any], held: Any = HELD) -> Any:
    """The same structure fitted to the records of one speed, derivatives constant."""
    at = replace(flights.structure(SPEEDS), U0=flights.trims[speed]["u"])
    start = replace(at.with_values_of(near[speed].model), **dict.fromkeys(HELD, 0.0))
    fixed = (*held, *(name for name in at.parameter_names() if "_V" in name))
    records = [flights.noisy(speed, name) for name in STEPS]
    estimator = OutputError(interval=2.0, biases=False, steps=1)
    path = folder / f"own {speed}{'' if held == HELD else ' freed'}.json"
    return kept(path, Flown, lambda: estimator.fit(start, records, fixed=fixed))


def along_speed(structure: Flown, models: Sequence[SixDof]) -> Flown:
    """Derivatives of local fits by straight lines over speed."""
    faster = [(model.U0 - structure.U0) / structure.span for model in models]
    values = {}
    for name in SixDof.parameter_names():
        if name in structure.parameter_names() and name not in HELD:
            found = [getattr(model, name) for model in models]
            slope, middle = np.polyfit(faster, found, 1)
            values |= {name: middle} | ({f"{name}_V": slope} if hasattr(structure, f"{name}_V")
                                        else {name: np.mean(found)})  # fmt: skip
    infos = structure.infos()
    within = {
        name: float(np.clip(value, infos[name].lower, infos[name].upper))
        for name, value in values.items()
    }
    return structure.with_values_of(type(structure)(**within))


def ratio(one: Any, other: Any) -> float:
    """Geometric mean over the outputs of the ratio of two RMS errors."""
    return float(np.exp(np.mean(np.log(np.asarray(one) / other))))


def simulated(flights: Flights, models: dict[str, Any], speed: str, name: str) -> dict[str, Any]:
    """RMS (8,) of the outputs by each model over a whole record."""
    rms = validate(models, flights.deviations(speed, name), horizon=np.inf).rms
    return {each: values[0] for each, values in rms.items()}


def predicted(flights: Flights, models: dict[str, Any], speed: str, name: str) -> dict[str, Any]:
    """RMS (8,) of the outputs by each model some seconds ahead, from a past that shows u, too."""
    record = flights.deviations(speed, name, outputs=(*OUTPUTS, "u"))
    rms = validate(models, record, horizon=AHEAD).rms
    return {each: values[0, : len(OUTPUTS)] for each, values in rms.items()}


def unseen(
    flights: Flights, near: dict[str, Any], alone: dict[str, Any], fits: dict[str, Any]
) -> Any:
    """Errors linearised at the measured trim over local and own fits, and as they are."""
    six = [(case, "SixDof") for case in (SIX, SIX_OUT, BASE, OUT)]
    pairs, rows = [*six, (BASE, "own"), (OUT, "own")], []
    for name in UNSEEN:
        for speed in SPEEDS:
            trim = Trim(values=flights.trims[speed])
            models = {"SixDof": near[speed], "own": alone[speed].model.at(trim)}
            models |= {case: fits[case].model.at(trim) for case, _ in six}
            e = simulated(flights, models, speed, name)
            pair = {"SixDof": near[speed], BASE: fits[BASE].model}
            ahead = predicted(flights, pair, speed, name)
            found = [ratio(e[a], e[b]) for a, b in pairs]
            rows.append((name, speed, *found, ratio(ahead[BASE], ahead["SixDof"])))
    head = (f"{a} / {b}" for a, b in pairs)
    return ("record", "speed", *head, f"{BASE}, as it is / SixDof, 3 s ahead"), rows


def changes(flights: Flights, near: dict[str, Any], fits: dict[str, Any]) -> Any:
    """Errors of predictions while the speed changes, over those of a fit that saw these records."""
    rows = []
    for name in CHANGES:
        models = {"SixDof": near["060kt"]} | {case: fits[case].model for case in (BASE, SEEN)}
        e = predicted(flights, models, "060kt", name)
        rows.append((name, ratio(e[BASE], e[SEEN]), ratio(e[BASE], e["SixDof"])))
    return ("record", "unseen / seen", "unseen / SixDof at 60 kn"), rows


def worth(flights: Flights, folder: Path, one: Any) -> Any:
    """Parameters and AICc of one model, of it with parabolas only, and of three, of the same R."""
    flown = {speed: [flights.noisy(speed, name) for name in STEPS] for speed in SPEEDS}
    every = [record for some in flown.values() for record in some]
    estimator, model = OutputError(interval=2.0, biases=False, steps=1, R=one.R), one.model
    still = {name: 0.0 for name in Flown.parameter_names() if "_V" in name}

    def fitted(name: str, start: Any, records: list[Record], fixed: Sequence[str] = HELD) -> Any:
        path = folder / f"{name}.json"
        return kept(path, type(start), lambda: estimator.fit(start, records, fixed=fixed))

    bow = bent()(U0=model.U0, speeds=model.speeds, curves=model.curves).with_values_of(model)
    curved = fitted("parabolas R", bow, every)
    straight = fitted("three R", model, every)
    rows = [
        (name, len(fit.free_names), aicc(fit, every))
        for name, fit in (("one model", straight), ("one model, parabolas", curved))
    ]
    three = []
    for speed, records in flown.items():
        start = replace(at_speed(curved.model, model, flights.trims[speed]["u"]), **still)
        three.append(fitted(f"own R {speed}", start, records, (*HELD, *still)))
    total = sum(aicc(fit, flown[speed]) for speed, fit in zip(SPEEDS, three, strict=True))
    rows.append(("three own fits", sum(len(fit.free_names) for fit in three), total))
    return ("", "parameters", "AICc"), [(*row[:2], f"{row[2]:.0f}") for row in rows]


def at_speed(curved: Any, model: Flown, speed: float) -> Flown:
    """The structure with the derivatives that another has at a speed, within bounds."""
    faster, infos = (speed - curved.U0) / curved.span, model.infos()
    values = {
        name: getattr(curved, name)
        + getattr(curved, f"{name}_V", 0.0) * faster
        + getattr(curved, f"{name}_VV", 0.0) * faster**2
        for name in infos
        if "_V" not in name and name not in HELD
    }
    within = {n: float(np.clip(v, infos[n].lower, infos[n].upper)) for n, v in values.items()}
    return replace(model, U0=speed, **within)


def beyond(fits: dict[str, Any]) -> Any:
    """What the derivatives by speed have beyond the trim curves, over their standard errors."""
    names = [name for name in HELD if name.endswith("u")]
    rows = [(n, *(fit[n].value / fit[n].std_error for fit in fits.values())) for n in names]
    return ("derivative, σ from the trim curves", *fits), rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--kept", type=Path, default=Path("out/envelope"))
    parser.add_argument("--seed", type=int, default=109)
    chosen = parser.parse_args()
    chosen.kept.mkdir(parents=True, exist_ok=True)
    flights = Flights(chosen.data, chosen.seed)
    warnings.simplefilter("ignore")  # of speeds beyond the trims
    folder = chosen.kept
    near = {speed: local(flights, folder, speed) for speed in SPEEDS}
    alone = {speed: own(flights, folder, speed, near) for speed in SPEEDS}
    fits = {case: scheduled(flights, folder, case, near) for case in CASES}
    freed = {FREED: fits[FREED], "60 kn alone": own(flights, folder, "060kt", near, TRIMS)}
    print(f"\n{table(*worth(flights, folder, fits[BASE]))}\n\n{table(*beyond(freed))}", flush=True)
    print(f"\n{table(*unseen(flights, near, alone, fits))}", flush=True)
    print(f"\n{table(*changes(flights, near, fits))}")


if __name__ == "__main__":
    main()
