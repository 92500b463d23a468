"""One scheduled model of a helicopter over 40 to 80 kn, against a fit at each speed.

Records are those of heli-gym's AW109 (folders 040kt, 060kt, 080kt of DATA) at 25 Hz, noise added,
an airspeed of 0.5 m/s among it: the four 3-2-1-1 at each speed, `ScheduledSixDof` started from
local fits of `SixDof` to the same records. Errors are those of simulations of noise-free records
that no fit has seen, geometric means over the outputs of their ratio to another's.

    OMP_NUM_THREADS=1 python -m benchmarks.envelope DATA [--kept FOLDER] [--seed N]

A fit in FOLDER is not made again.
"""

import argparse
import time
from collections.abc import Callable, Sequence
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
from models.scheduled_six_dof import CURVES, ScheduledSixDof
from models.six_dof import SixDof

SPEEDS = ("040kt", "060kt", "080kt")
UNSEEN = ("validation_random", "validation_large")
BASE = "three speeds"
SPEED_NOISE = 0.5  # m/s
BENT = tuple(f"{n}_VV" for n in ("Zw", "Zcol", "Mw", "Mq", "Mcol", "Mlon", "Nv", "Nr", "Nped"))
TRIMS = tuple(f"{axis}trim" for axis in "XYZLMN")
HELD = ScheduledSixDof.balance
# Speeds of a fit, what it holds.
CASES = {
    BASE: (SPEEDS, HELD),
    "without 60 kn": (SPEEDS[::2], (*HELD, *BENT)),
    "speed derivatives free": (SPEEDS, TRIMS),
}


class Flown(ScheduledSixDof):
    """The structure with a measured airspeed, some derivatives parabolas over speed."""

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

    def measurements(self, x: Any, u: Any) -> Sequence[Any]:
        return [*ScheduledSixDof.measurements(self, x, u), x.u]


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

    def deviations(self, speed: str, name: str, *, noisy: bool = False) -> Record:
        """One record from the trim of its speed."""
        record = self.noisy(speed, name) if noisy else self.read(speed, name, (*OUTPUTS, "u"))
        return record.detrend(self.trims[speed]).select(outputs=OUTPUTS)

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
    speeds, fixed = CASES[case]
    records = [flights.noisy(speed, name) for speed in speeds for name in STEPS]
    start = along_speed(flights.structure(speeds), [near[speed].model for speed in speeds])
    estimator = OutputError(interval=2.0, biases=False, steps=1)
    return kept(folder / f"{case}.json", Flown, lambda: estimator.fit(start, records, fixed=fixed))


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


def unseen(flights: Flights, near: dict[str, Any], fits: dict[str, Any]) -> Any:
    """Errors over those of the local fit: linearised at the measured trim, and as they are."""
    rows = []
    for name in UNSEEN:
        for speed in SPEEDS:
            record, trim = flights.deviations(speed, name), Trim(values=flights.trims[speed])
            models = {"local": near[speed], "as it is": fits[BASE]}
            models |= {case: fits[case].model.at(trim) for case in CASES}
            rms = {n: validate({n: m}, record, horizon=np.inf).rms[n][0] for n, m in models.items()}
            rows.append((name, speed, *(ratio(rms[n], rms["local"]) for n in (*CASES, "as it is"))))
    return (
        "record",
        "speed",
        *(f"{case}, linearised" for case in CASES),
        f"{BASE}, as it is",
    ), rows


def beyond(fit: Any) -> Any:
    """What the derivatives by speed have beyond the trim curves."""
    rows = [(name, fit[name].value, fit[name].std_error) for name in HELD if name.endswith("u")]
    rows = [(*row, abs(row[1]) / row[2]) for row in rows]
    return ("derivative", "value", "standard error", "ratio"), rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--kept", type=Path, default=Path("out/envelope"))
    parser.add_argument("--seed", type=int, default=109)
    chosen = parser.parse_args()
    chosen.kept.mkdir(parents=True, exist_ok=True)
    flights = Flights(chosen.data, chosen.seed)
    near = {speed: local(flights, chosen.kept, speed) for speed in SPEEDS}
    fits = {case: scheduled(flights, chosen.kept, case, near) for case in CASES}
    print(f"{len(fits[BASE].free_names)} parameters for {3 * len(near[SPEEDS[0]].free_names)}")
    for title, rows in (
        ("error / local", unseen(flights, near, fits)),
        ("beyond balance", beyond(fits["speed derivatives free"])),
    ):
        print(f"\n{title}\n")
        print(table(*rows))


if __name__ == "__main__":
    main()
