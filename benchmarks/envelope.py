"""One scheduled model of a helicopter over 40 to 80 kn, against a fit at each speed.

Records are those of heli-gym's AW109 (folders 040kt, 060kt, 080kt of DATA) at 25 Hz, noise added,
an airspeed of 0.5 m/s among it: the four 3-2-1-1 at each speed, `ScheduledHybrid` started from
fits of it to the records of one speed ("own"), these from a fit of `SixDof`. Errors are those of
simulations, or predictions 3 s ahead, of noise-free records that no fit has seen, geometric means
over the outputs of their ratio to another's.

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
    NonlinearModel,
    OutputError,
    Record,
    Scalar,
    SolverOptions,
    Trim,
    output_error,
    parameter,
    read_csv,
    simulate,
    validate,
)
from casid.bounds.trials import aicc
from models.scheduled_hybrid import CURVES, ScheduledHybrid
from models.six_dof import SixDof

SPEEDS = ("040kt", "060kt", "080kt")
UNSEEN = ("validation_random", "validation_large")
CHANGES = ("accelerate", "decelerate")
AHEAD = 3.0  # s, of predictions: the phugoid is unstable
BASE, OUT = "three speeds", "without 60 kn"
FREED, SEEN = "speed derivatives free", "with changes of speed"
SPEED_NOISE = 0.5  # m/s
LAG = 13.0  # 1/s, of flapping, to start from
TAUS = ("tau_col", "tau_lat", "tau_lon", "tau_ped")  # sticks are recorded behind the servos
HELD = (*ScheduledHybrid.balance, *TAUS)
# Speeds of a fit, what it holds, manoeuvres at 60 kn beside the 3-2-1-1.
CASES: dict[str, tuple[Sequence[str], Sequence[str], Sequence[str]]] = {
    BASE: (SPEEDS, HELD, ()),
    OUT: (SPEEDS[::2], HELD, ()),
    FREED: (SPEEDS, TAUS, ()),
    SEEN: (SPEEDS, HELD, CHANGES),
}
ESTIMATOR = OutputError(
    interval=2.0, biases=False, steps=1, solver=SolverOptions(tolerance=1e-6, max_iterations=100)
)


class Flown(ScheduledHybrid):
    """With roll and yaw moments by pitch attitude.

    They are no aerodynamics: in this simulation the power of a climb is a torque at once.
    """

    Ltheta: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="1/s^2")
    Ltheta_V: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="1/s^2")
    Ntheta: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="1/s^2")
    Ntheta_V: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="1/s^2")


SLOPES = tuple(name for name in Flown.parameter_names() if "_V" in name)
BENT = tuple(name for name in SLOPES if name.endswith("_VV"))  # two speeds do not tell


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


def scheduled(flights: Flights, folder: Path, case: str, alone: dict[str, Any]) -> Any:
    """The structure fitted to the records of a case, from the fits to one speed each."""
    speeds, fixed, more = CASES[case]
    fixed = fixed if len(speeds) > 2 else (*fixed, *BENT)
    records = [flights.noisy(speed, name) for speed in speeds for name in STEPS]
    records += [flights.noisy("060kt", name) for name in more]
    start = along_speed(flights.structure(speeds), [alone[speed].model for speed in speeds])
    return kept(folder / f"{case}.json", Flown, lambda: ESTIMATOR.fit(start, records, fixed=fixed))


def own(flights: Flights, path: Path, speed: str, near: Any, **settings: Any) -> Any:
    """The same structure fitted to the records of one speed, derivatives constant."""
    fixed = (*settings.pop("held", HELD), *SLOPES)
    at = replace(flights.structure(SPEEDS), U0=flights.trims[speed]["u"])
    start = from_quasi_steady(at, near) if isinstance(near, SixDof) else at.with_values_of(near)
    start = replace(start, **dict.fromkeys((*HELD, *SLOPES), 0.0))
    records = [flights.noisy(speed, name) for name in STEPS]
    estimator = replace(ESTIMATOR, **settings)
    return kept(path, Flown, lambda: estimator.fit(start, records, fixed=fixed))


def from_quasi_steady(at: Flown, six: SixDof) -> Flown:
    """The flapping that has a quasi-steady rotor's damping and control of roll and pitch."""
    Mb1c, Lb1s = max(-LAG * six.Mq, 1.0), -LAG * six.Lp
    flap = {"Mfb1c": -LAG, "Lfb1s": -LAG, "Mb1c": Mb1c, "Lb1s": Lb1s}
    for stick in ("lat", "lon"):
        flap[f"Mf{stick}"] = getattr(six, f"M{stick}") * LAG / Mb1c
        flap[f"Lf{stick}"] = getattr(six, f"L{stick}") * LAG / Lb1s
    moved = dict.fromkeys(("Mlat", "Llon", "Mq"), 0.0)
    return within(at, {n: getattr(six, n) for n in six.parameter_names()} | flap | moved)


def along_speed(structure: Flown, models: Sequence[Flown]) -> Flown:
    """Parabolas or straight lines over speed through local fits, as the structure has them."""
    faster = [(model.U0 - structure.U0) / structure.span for model in models]
    values, names = {}, structure.parameter_names()
    for name in names:
        if name not in (*HELD, *SLOPES):
            own = [each for each in (name, f"{name}_V", f"{name}_VV") if each in names]
            degree = min(len(own), len(models)) - 1
            line = np.polyfit(faster, [getattr(model, name) for model in models], degree)
            values |= dict(zip(own, line[::-1], strict=False))
    return within(structure, values | dict.fromkeys(HELD, 0.0))


def within(structure: Flown, values: dict[str, float]) -> Flown:
    """The structure with values of its parameters, brought within their bounds."""
    return replace(structure, **{
        name: float(np.clip(values[name], info.lower, info.upper))
        for name, info in structure.infos().items() if name in values
    })  # fmt: skip


def ratio(one: Any, other: Any) -> float:
    """Geometric mean over the outputs of the ratio of two RMS errors."""
    return float(np.exp(np.mean(np.log(np.asarray(one) / other))))


def errors(
    flights: Flights, models: dict[str, Any], speed: str, name: str, horizon: float = AHEAD
) -> dict[str, Any]:
    """RMS (8,) of the outputs by each model over a record; nonlinear ones see u, too."""
    nonlinear = any(isinstance(model, NonlinearModel) for model in models.values())
    shown = (*OUTPUTS, "u") if nonlinear else OUTPUTS
    rms = validate(models, flights.deviations(speed, name, outputs=shown), horizon=horizon).rms
    return {each: values[0, : len(OUTPUTS)] for each, values in rms.items()}


def unseen(
    flights: Flights, near: Any, alone: Any, fits: dict[str, Any], *, linear: bool = True
) -> Any:
    """Errors of simulations, linearised at the measured trim perhaps, and as they are 3 s ahead."""
    pairs = [(one, other) for other in ("SixDof", "own") for one in (BASE, OUT)]
    rows = []
    for name in UNSEEN:
        for speed in SPEEDS:
            six = {"SixDof": near[speed].model}
            models = {"own": alone[speed].model} | {case: fits[case].model for case in (BASE, OUT)}
            whole = models
            if linear:
                whole = {each: linear_at(flights, model, speed) for each, model in models.items()}
            e = errors(flights, six | whole, speed, name, np.inf)
            ahead = errors(flights, six | models, speed, name)
            rows.append(
                (name, speed, *(ratio(rms[a], rms[b]) for rms in (e, ahead) for a, b in pairs))
            )
    head = [f"{a} / {b}" for a, b in pairs]
    return ("record", "speed", *head, *(f"{each}, {AHEAD:.0f} s ahead" for each in head)), rows


def changes(flights: Flights, near: dict[str, Any], fits: dict[str, Any]) -> Any:
    """Errors while the speed changes, over those of a fit that saw these records."""
    rows = []
    for name in CHANGES:
        record = flights.read("060kt", name, (*OUTPUTS, "u", "v", "w"))
        piece = {case: pieces(fits[case].model, record) for case in (BASE, SEEN)}
        models = {"SixDof": near["060kt"]} | {case: fits[case].model for case in (BASE, SEEN)}
        e = errors(flights, models, "060kt", name)
        found = ratio(piece[BASE], piece[SEEN]), ratio(e[BASE], e[SEEN])
        rows.append((name, *found, ratio(e[BASE], e["SixDof"])))
    ahead = f"{AHEAD:.0f} s ahead"
    head = (
        f"unseen / seen, {ahead} of recorded states",
        f"unseen / seen, {ahead} of filtered ones",
    )
    return ("record", *head, f"unseen / SixDof at 60 kn, {ahead} of filtered ones"), rows


def linear_at(flights: Flights, model: Any, speed: str) -> Any:
    """A nonlinear model linearised at the measured trim, what was not measured in balance."""
    trim = flights.trims[speed]
    return model.at(Trim(values=trim | balanced(model, trim)))


def pieces(model: Any, record: Record) -> Any:
    """RMS (8,) of simulations of some seconds, each from the recorded state, flapping settled."""
    errors = []
    for begin in np.arange(record.t[0], record.t[-1] - AHEAD, AHEAD):
        piece = record.cut(begin, begin + AHEAD)
        seen = piece.select(outputs=model.outputs)
        found = simulate(model, seen, settled(model, piece))
        errors.append((found.y - seen.y)[1:, : len(OUTPUTS)])
    return np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


def settled(model: Any, record: Record) -> dict[str, float]:
    """The first state of a record, those that are not recorded in balance with the others."""
    first = {name: float(values[0]) for name, values in record.totals().items()}
    return balanced(model, first)


def balanced(model: Any, known: dict[str, float]) -> dict[str, float]:
    """States of a flight condition, those that are not known in balance with the others."""
    typical = zip(model.states, model.operating_point()[0], strict=True)
    x = np.array([known.get(name, value) for name, value in typical])
    u = [known[name] for name in model.inputs]
    rest = [i for i, name in enumerate(model.states) if name not in known]
    equations, lam = model.equations(), model.vector()
    for _ in range(8):
        moves = np.vstack([x, x + 1e-4 * np.eye(len(x))[rest]])
        f = np.array([equations(each, u, lam)[0].full().ravel() for each in moves])
        x[rest] -= 1e-4 * np.linalg.solve((f[1:] - f[0])[:, rest].T, f[0, rest])
    return dict(zip(model.states, x, strict=True))


def worth(flights: Flights, folder: Path, one: Any, alone: dict[str, Any]) -> Any:
    """Parameters and AICc of one model and of three, each with its own R, or all with one's."""
    flown = {speed: [flights.noisy(speed, name) for name in STEPS] for speed in SPEEDS}
    every = [record for some in flown.values() for record in some]
    alike = {
        speed: own(flights, folder / f"own R {speed}.json", speed, fit.model, R=one.R)
        for speed, fit in alone.items()
    }
    n, whole = len(one.free_names), aicc(one, every)
    apart = whole + 2 * (cost_apart(one, list(flown.values())) - one.cost)
    apart += 2 * len(one.R) * (len(SPEEDS) - 1)
    rows = [("one model", n, whole), ("one model, an R a speed", n, apart)]
    for name, fits in (("three own fits, R of the one", alike), ("three own fits", alone)):
        total = sum(aicc(fit, flown[speed]) for speed, fit in fits.items())
        rows.append((name, sum(len(fit.free_names) for fit in fits.values()), total))
    rows = [(name, count, f"{value:.0f}") for name, count, value in rows]
    return ("", "parameters", "AICc"), rows


def cost_apart(fit: Any, groups: Sequence[Sequence[Record]]) -> float:
    """Negative log-likelihood of a fit as it is, if each group of records had its own R."""
    cost, first = 0.0, iter(fit.initial_states)
    for records in groups:
        paths = [
            simulate(fit.model, record, dict(zip(fit.model.states, next(first), strict=True)))
            for record in records
        ]
        pairs = zip(paths, records, strict=True)
        residuals = np.concatenate([path.y - record.y for path, record in pairs])
        N, ny = residuals.shape
        cost += N * (np.log(np.sqrt(np.mean(residuals**2, axis=0))).sum() + ny / 2)
    return float(cost)


def beyond(fits: dict[str, Any], trim: Trim) -> Any:
    """What the derivatives by speed have beyond the trim curves, over their standard errors."""
    free = fits[FREED].model
    A = replace(free, **dict.fromkeys(ScheduledHybrid.balance, 0.0)).at(trim).system().A
    whole = (A[:8, :8] - A[:8, 8:] @ np.linalg.solve(A[8:, 8:], A[8:, :8]))[:6, 0]  # rotor settled
    rows = [
        (name, 100 * getattr(free, name) / own, *(
            fit[name].value / fit[name].std_error for fit in fits.values()
        ))
        for name, own in zip(ScheduledHybrid.balance, whole, strict=True)
    ]  # fmt: skip
    return ("beyond the trim curves", f"{FREED}, %", *(f"{fit}, σ" for fit in fits)), rows


def asked(doc: str, kept: str) -> tuple[Flights, Path]:
    """Records and the folder of fits that a command line names."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--kept", type=Path, default=Path(kept))
    parser.add_argument("--seed", type=int, default=109)
    chosen = parser.parse_args()
    chosen.kept.mkdir(parents=True, exist_ok=True)
    return Flights(chosen.data, chosen.seed), chosen.kept


def main() -> None:
    flights, folder = asked(__doc__, "out/envelope")
    warnings.simplefilter("ignore")  # of speeds beyond the trims
    near = {speed: local(flights, folder, speed) for speed in SPEEDS}
    middle = own(flights, folder / "own 060kt.json", "060kt", near["060kt"].model)
    alone = {
        speed: own(flights, folder / f"own {speed}.json", speed, middle.model) for speed in SPEEDS
    }
    fits = {case: scheduled(flights, folder, case, alone) for case in CASES}
    middle_trim = Trim(values=flights.trims["060kt"])
    freed = {FREED: fits[FREED]} | {
        f"{speed} alone": own(flights, folder / f"freed {speed}.json", speed, fit.model, held=TAUS)
        for speed, fit in alone.items()
    }
    print(f"\n{table(*worth(flights, folder, fits[BASE], alone))}", flush=True)
    print(f"\n{table(*beyond(freed, middle_trim))}", flush=True)
    print(f"\n{table(*unseen(flights, near, alone, fits))}", flush=True)
    print(f"\n{table(*changes(flights, near, fits))}")


if __name__ == "__main__":
    main()
