"""Which structure follows an articulated rotor: J of every pair, and the error on unseen flight.

First every structure is fitted to the exact response of the 32-state model, all 32 pairs over
0.5-12 rad/s. Then it is identified from the noisy sweeps of the nonlinear helicopter (pairs and
points with coherence 0.6 or more) and compared with the exact response, delayed by the 4 ms at
which the two agree best, and with the record of random inputs that nothing was fitted to. Last,
output error on the noisy 3-2-1-1 refines two of these fits: what the time domain adds. J is the
cost of M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed.,
section 11.2: 100 is a good model, 50 one that can hardly be told from the aircraft. And where
output error ends from other starts.

"+" after a structure's name means with the derivatives that its file leaves out.

Run: python -m benchmarks.structures
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.uh60 import (
    DATA,
    INPUTS,
    NOISE,
    ON_AXIS,
    ORACLE_DELAY,
    OUTPUTS,
    STEPS,
    SWEEPS,
    oracle,
)
from casid import (
    FrequencyResponse,
    derivid,
    frequency_response,
    match,
    output_error,
    parameter,
    pbsid,
    read_csv,
    validate,
)
from casid.matching.mismatch import pair_weights, weighted_errors
from models.hybrid_flap import HybridFlap
from models.hybrid_flap_lag import HybridFlapLag
from models.six_dof import SixDof

OMEGA = np.geomspace(0.5, 12.0, 20)
MEASURED = np.geomspace(0.4, 14.0, 40)
BAND = (0.5, 14.0)
FULL_TRAVEL = 100.0  # the 32-state model's sticks are in percent
SEED = 20130

# Rows of A and B by the head of a derivative's name, and what HybridFlap leaves out.
ROWS = {"X": "u", "Y": "v", "Z": "w", "L": "p", "M": "q", "N": "r", "Mf": "b1c", "Lf": "b1s"}
LEFT_OUT = {"Xr", "Yu", "Yw", "Zu", "Zv", "Zq", "Lu", "Lped", "Nlat", "Mflat"}

# Trim of the 32-state model and of the records, SI units.
EXACT_TRIM = {"U0": 41.017, "V0": 2.7046, "W0": 2.1073, "theta0": 0.05133}
TRIM = {"U0": 40.922, "V0": 2.811, "W0": 2.054, "phi0": 0.0213, "theta0": 0.0531}


@dataclass(frozen=True)
class Row:
    """One structure: J (8, 4), NaN where not measured, and errors on the validation record."""

    name: str
    parameters: int
    J: np.ndarray
    rms: np.ndarray | None = None

    @property
    def on_axis(self):
        """J of az/col, p/lat, q/lon and r/ped."""
        return np.array([self.J[OUTPUTS.index(y), INPUTS.index(u)] for y, u in ON_AXIS])

    @property
    def off_axis(self):
        """J of the other pairs that were measured."""
        off = self.J.copy()
        for y, u in ON_AXIS:
            off[OUTPUTS.index(y), INPUTS.index(u)] = np.nan
        return off[~np.isnan(off)]


def place(structure, name):
    """Matrix ("A" or "B"), row and column of a derivative."""
    for head in (name[:2], name[:1]):
        tail = name[len(head) :]
        tail = f"b1{tail}" if len(head) == 2 and tail in {"c", "s"} else tail
        for letter, columns in (("A", structure.states), ("B", structure.inputs)):
            if head in ROWS and tail in columns:
                return letter, structure.states.index(ROWS[head]), columns.index(tail)
    raise ValueError(f"{name} is no derivative of {structure.__name__}")


def extended(structure, names):
    """The structure with more derivatives; forces' appear in the specific forces, too."""
    places = {name: place(structure, name) for name in names}

    def rows(own, source, count):
        def build(self):
            M = [list(row) for row in getattr(structure, own)(self)]
            for name, (letter, i, j) in places.items():
                if letter == source and i < count:
                    M[i][j] = M[i][j] + getattr(self, name)
            return M

        return build

    nx = len(structure.states)
    body = {"A": rows("A", "A", nx), "B": rows("B", "B", nx), "C": rows("C", "A", 3),
            "D": rows("D", "B", 3)}  # fmt: skip
    body |= {name: parameter(default=0.0, lower=-100.0, upper=100.0, unit="-") for name in names}
    body |= {"__annotations__": dict.fromkeys(names, float), "__module__": __name__}
    return type(f"{structure.__name__}+", (structure,), body)


def exact_response():
    """The 32-state model's response as a perfect measurement."""
    G = FULL_TRAVEL * oracle().response(OMEGA)
    size = np.sqrt(np.mean(np.abs(G) ** 2, axis=(0, 2)))
    return FrequencyResponse(
        omega=OMEGA, G=G, coherence=np.ones(G.shape), random_error=np.full(G.shape, 1e-3),
        inputs=INPUTS, outputs=OUTPUTS, input_std=np.full(4, 0.03), output_std=0.03 * size,
    )  # fmt: skip


def cost(system, G, coherence):
    """J of every pair (8, 4) where coherence is 0.6 or more at five points; else NaN."""
    used = coherence >= 0.6
    used &= used.sum(axis=0) >= 5
    error = weighted_errors(system.response(OMEGA), G, pair_weights(coherence, used))
    return np.where(used.any(axis=0), np.sum(error**2, axis=(0, 1)), np.nan)


def fit_exact(structure, starts=2):
    """One structure against the exact response of the 32-state model."""
    target = exact_response()
    fit = derivid(structure(**EXACT_TRIM), target, starts=starts)
    J = cost(fit.model.system(), target.G, target.coherence)
    return Row(structure.__name__, len(fit.parameters), J)


def records(names, seed=None, trim="first"):
    """Nonlinear records with sticks as fractions of full travel, with noise unless seed is None."""
    units = dict.fromkeys(INPUTS, "%")
    read = [
        read_csv(DATA / f"{name}.csv", inputs=INPUTS, outputs=OUTPUTS, units=units, detrend=trim)
        for name in names
    ]
    if seed is None:
        return read
    rng = np.random.default_rng(seed)
    return [record.with_noise(NOISE, rng) for record in read]


def unseen():
    """The record of random inputs about the mean trim of the others, noise-free."""
    others = records(STEPS + SWEEPS)
    trim = {name: np.mean([r.trim[name] for r in others]) for name in (*INPUTS, *OUTPUTS)}
    return records(["validation_random"], trim=trim)


def fit_measured(structure, measured, validation, starts=2):
    """One structure identified from the measured response of the noisy sweeps."""
    fit = derivid(structure(**TRIM), measured, band=BAND, starts=starts)
    coherence = np.nan_to_num(measured.coherence)
    at = np.array([[np.interp(OMEGA, measured.omega, coherence[:, i, j]) for j in range(4)]
                   for i in range(8)])  # fmt: skip
    G = FULL_TRAVEL * oracle(ORACLE_DELAY).response(OMEGA)
    J = cost(fit.model.system(), G, at.transpose(2, 0, 1))
    rms = validate({"m": fit}, validation).rms["m"][0]
    return Row(structure.__name__, len(fit.parameters), J, rms)


def table(rows):
    """Markdown: J on axis, off axis, and RMS errors where there are any."""
    names = [f"{y}/{u}" for y, u in ON_AXIS]
    head = ["structure", "parameters", *names, "off axis, mean", "worst", "all, mean"]
    head += ["p [mrad/s]", "q [mrad/s]"] * (rows[0].rms is not None)
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        values = [*row.on_axis, row.off_axis.mean(), row.off_axis.max(), np.nanmean(row.J)]
        cells = [row.name, str(row.parameters), *(f"{value:.0f}" for value in values)]
        if row.rms is not None:
            cells += [f"{1e3 * row.rms[OUTPUTS.index(y)]:.2f}" for y in ("p", "q")]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def pairs(row):
    """Markdown: J of every pair of one structure."""
    lines = [f"| {row.name} | " + " | ".join(INPUTS) + " |", "|---|" + "---|" * len(INPUTS)]
    for output, values in zip(OUTPUTS, row.J, strict=True):
        cells = ("-" if np.isnan(value) else f"{value:.0f}" for value in values)
        lines.append(f"| {output} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def refined(structure, measured, validation):
    """RMS errors (8,) on the unseen record: the fit to the sweeps, and refined on the 3-2-1-1."""
    alone = derivid(structure(**TRIM), measured, band=BAND, starts=2)
    steps = [record.decimate(2) for record in records(STEPS, SEED + 1)]
    models = {"FD only": alone, "TD/FD": output_error(alone.model, steps)}
    found = validate(models, validation).rms
    return {f"{structure.__name__}, {name}": found[name][0] for name in models}


def endings(structure, measured):
    """Markdown: where output error ends from three starts, and on twice the records."""
    full = records(STEPS, SEED + 1) + records(SWEEPS, SEED)
    every = [record.decimate(2) for record in full]
    box = pbsid(full, order=18, feedthrough=["ax", "ay", "az"])
    alone = derivid(structure(**TRIM), measured, band=BAND, starts=2).model
    near = match(structure(**TRIM), [box, measured]).model
    lines = ["| start | records | cost | iterations |", "|---|---|---|---|"]
    for start, model, flown in (
        ("guesses of the file", structure(**TRIM), every[:4]),
        ("H-infinity match", near, every[:4]),
        ("frequency-domain fit", alone, every[:4]),
        ("frequency-domain fit", alone, every),
    ):
        fit = output_error(model, flown)
        lines.append(f"| {start} | {len(flown)} | {fit.cost:.3f} | {fit.iterations} |")
    return "\n".join(lines)


def refinement(rms):
    """Markdown: RMS errors of every output."""
    lines = ["| model | " + " | ".join(OUTPUTS) + " |", "|---" * (len(OUTPUTS) + 1) + "|"]
    lines += [
        f"| {name} | " + " | ".join(f"{1e3 * value:.2f}" for value in values) + " |"
        for name, values in rms.items()
    ]
    return "\n".join(lines)


def structures():
    """Those of the gallery for six degrees of freedom, and the hybrid ones with all derivatives."""
    whole = LEFT_OUT | set(HybridFlap.parameter_names())
    more = sorted(whole - set(HybridFlapLag.parameter_names()))
    full = extended(HybridFlap, sorted(LEFT_OUT)), extended(HybridFlapLag, more)
    return SixDof, HybridFlap, HybridFlapLag, *full


def main():
    """Print all tables."""
    exact = [fit_exact(structure) for structure in structures()]
    print("J against the exact response of the 32-state model, fitted to it\n")
    print(table(exact), *(pairs(row) for row in exact), sep="\n\n")
    measured = frequency_response(records(SWEEPS, SEED), omega=MEASURED)
    validation = unseen()
    found = [fit_measured(structure, measured, validation) for structure in structures()]
    print("\nThe same, identified from the noisy sweeps; RMS errors on the unseen record\n")
    print(table(found), *(pairs(row) for row in found), sep="\n\n")
    rms = {}
    for structure in (SixDof, HybridFlap):
        rms |= refined(structure, measured, validation)
    print("\nRMS errors on the unseen record [mm/s^2, mrad/s, mrad]\n", refinement(rms), sep="\n")
    print("\nHybridFlap: where output error ends\n", endings(HybridFlap, measured), sep="\n")


if __name__ == "__main__":
    main()
