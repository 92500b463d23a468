"""The paper's comparison: time and frequency domain together against the frequency domain alone.

For each helicopter: a black box from 3-2-1-1 records; frequency responses from sweeps; the TD/FD
model, matched to both in the H∞ norm and refined by output error on the 3-2-1-1; the FD-only model,
the classical fit to the frequency responses. Figures 1-8 compare their responses with the truth,
9-10 the time histories of records that no estimation has seen, 11 the RMS errors. M. Bergamasco,
M. Lovera, "Rotorcraft system identification: a time/frequency domain approach", section 4. One
model more than there, "all refined": the same, but the last step takes the sweeps too.

Run: python examples/paper.py [folder]. Writes figures and report.md to out/paper.
"""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from casid import (
    Fit,
    FrequencyResponse,
    Model,
    Record,
    StateSpace,
    derivid,
    frequency_response,
    match,
    output_error,
    pbsid,
    read_csv,
    validate,
)

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
from models.six_dof import SixDof  # noqa: E402 - the gallery lies beside the examples

STICKS = SixDof.inputs
NOISE = dict(zip(SixDof.outputs, (0.05, 0.05, 0.1, 0.003, 0.003, 0.003, 0.003, 0.003), strict=True))
SEED = 20130
OMEGA = np.geomspace(0.4, 12.0, 40)
FORCES, RATES, ANGLES, SPEEDS = (
    ("ax", "ay", "az"),
    ("p", "q", "r"),
    ("phi", "theta"),
    ("u", "v", "w"),
)
UNITS = dict.fromkeys(FORCES, "m/s²") | dict.fromkeys(RATES, "rad/s")
UNITS |= dict.fromkeys(ANGLES, "rad")
LINES = {
    "truth": {"color": "black", "linewidth": 1.6},
    "TD/FD": {"color": "0.55", "linewidth": 1.6},
    "FD only": {"color": "0.55", "linewidth": 1.4, "linestyle": "--"},
}
COMBINED = ("TD/FD", "all refined")
BARS = {"black box": "0.15", "TD/FD": "0.5", "FD only": "0.8"}


@dataclass(frozen=True, kw_only=True)
class Case:
    """A helicopter: its records, the structure with its trim, and the truth."""

    name: str
    model: Model
    steps: list[Record]
    sweeps: list[Record]
    unseen: list[Record]
    truth: StateSpace | FrequencyResponse
    truth_name: str
    band: tuple[float, float]  # rad/s in which the truth is one
    thin: int  # every how many samples output error takes: fewer only if no stick's step is lost


# ---- the two helicopters ------------------------------------------------------------------------


def uh60() -> Case:
    """Nonlinear blade-element simulation of an unstable helicopter; truth: its 32-state model."""
    units = dict.fromkeys(STICKS, "%")
    steps, sweeps = (
        read("uh60", [f"{kind}_{stick}" for stick in STICKS], units) for kind in ("3211", "sweep")
    )
    unseen = read("uh60", ["validation_random"], units, trim=dict(steps[0].trim))
    model = SixDof(U0=40.922, V0=2.811, W0=2.054, R0=0.0057, phi0=0.0213, theta0=0.0531)
    return Case(
        name="UH-60", model=model, steps=noisy(steps, 0), sweeps=noisy(sweeps, 1), unseen=unseen,
        truth=uh60_truth(), truth_name="32-state model", band=(0.4, 12.0), thin=2,
    )  # fmt: skip


def ah1s() -> Case:
    """JSBSim's AH-1S; truth: the noise-free conditioned responses of its sweeps."""
    steps, sweeps = (
        read("ah1s", [f"{kind}_{stick}" for stick in STICKS]) for kind in ("3211", "sweep")
    )
    unseen = read("ah1s", [f"3211_{stick}_open" for stick in STICKS])
    exact = read("ah1s", [record.name for record in sweeps], outputs=(*SixDof.outputs, *SPEEDS))
    model = SixDof(U0=41.13, V0=0.035, W0=-1.412, phi0=-0.0251, theta0=-0.0343)
    return Case(
        name="AH-1S", model=model, steps=noisy(steps, 2), sweeps=noisy(sweeps, 3), unseen=unseen,
        truth=frequency_response(exact, omega=OMEGA, method="windows"),
        truth_name="noise-free sweeps", band=(0.4, 12.0), thin=1,
    )  # fmt: skip


def read(folder, names, units=None, trim="first", outputs=SixDof.outputs):
    """Records as perturbations from their trim."""
    return [
        read_csv(
            HERE / folder / "data" / f"{name}.csv", inputs=STICKS, outputs=outputs,
            units=units, detrend=trim,
        )
        for name in names
    ]  # fmt: skip


def noisy(records, stream):
    """Measurement noise from a recorded seed, another stream for each set of records."""
    rng = np.random.default_rng([SEED, stream])
    return [record.with_noise(NOISE, rng) for record in records]


def uh60_truth() -> StateSpace:
    """32-state model with the records' channels; sticks as fractions of full travel."""
    content = json.loads((HERE / "uh60" / "uh60_genhel_080kt.json").read_text())
    A = np.array(content["A"])
    B = 100 * np.array(content["B"])[:, [2, 0, 1, 3]]  # stored lat, lon, col, ped, per percent
    U0, V0, W0 = 0.3048 * np.array(content["trim_x0_ftlb"][:3])
    theta0, g = content["trim_x0_ftlb"][7], 9.80665
    C, D = np.zeros((8, len(A))), np.zeros((8, 4))
    C[:3], D[:3] = A[:3], B[:3]  # specific forces: accelerations less gravity and transport terms
    C[0, [4, 5, 7]] += W0, -V0, g * np.cos(theta0)
    C[1, [3, 5, 6]] += -W0, U0, -g * np.cos(theta0)
    C[2, [3, 4, 7]] += V0, -U0, g * np.sin(theta0)
    C[3:, 3:8] = np.eye(5)
    states = (*SPEEDS, *SixDof.outputs[3:], *(f"x{i}" for i in range(8, len(A))))
    return StateSpace(
        A, B, C, D, None, STICKS, SixDof.outputs, states, np.full(4, 0.004)
    )  # the records lie 4 ms behind it


def quasi_steady() -> StateSpace:
    """Eight-state linearisation of the AH-1S, valid below about 3 rad/s: rates and attitudes."""
    content = json.loads((HERE / "ah1s" / "ah1s_jsbsim_080kt.json").read_text())
    A, B = np.array(content["A"]), np.array(content["B"])[:, [0, 2, 1, 3]]  # stored col, lon, lat
    units = dict.fromkeys(SPEEDS, "m/s") | dict.fromkeys(RATES, "rad/s")
    stored = [f"{name} {units.get(name, 'rad')}" for name in SixDof.states]
    rows = [content["states"].index(name) for name in stored]
    A, B = A[np.ix_(rows, rows)], B[rows]
    C = np.eye(8)[[3, 4, 5, 6, 7]]
    outputs = (*RATES, *ANGLES)
    return StateSpace(A, B, C, np.zeros((5, 4)), None, STICKS, outputs, SixDof.states)


# ---- the comparison -----------------------------------------------------------------------------


def identify(case: Case):
    """Black box, TD/FD, FD only, TD/FD with the sweeps refined too; and the match on the way."""
    black_box = pbsid(
        case.steps, order=18, pole=10.0, past=10, future=10, feedthrough=["ax", "ay", "az"]
    )  # the settings of examples/uh60/study.toml
    frf = frequency_response(case.sweeps, omega=OMEGA, method="windows")  # as CIFER does
    band = (max(case.band[0], black_box.band[0]), min(case.band[1], black_box.band[1]))
    matched = match(case.model, [black_box, frf], norm="hinf", omega=np.geomspace(*band, 40))
    steps, sweeps = ([r.decimate(case.thin) for r in each] for each in (case.steps, case.sweeps))
    refined = output_error(matched.model, steps)
    models = {
        "black box": black_box, "TD/FD": refined, "FD only": derivid(case.model, frf),
        "all refined": output_error(refined.model, steps + sweeps),
    }  # fmt: skip
    return models, matched


def response_error(case: Case, system: StateSpace, reference, outputs, low, high) -> float:
    """Median over ω of ‖S_y⁻¹(Ĝ - G)S_u‖_F / ‖S_y⁻¹ G S_u‖_F between low and high rad/s."""
    omega = OMEGA[(low <= OMEGA) & (high >= OMEGA)]
    su, sy = (np.std(np.vstack([getattr(r, x) for r in case.unseen]), axis=0) for x in "uy")
    rows = [case.model.outputs.index(name) for name in outputs]
    scale = su / sy[rows, None]
    G = response(reference, omega, outputs)
    G_hat = system.response(omega)[:, rows]
    known = np.isfinite(G)
    error = np.where(known, (G_hat - G) * scale, 0.0)
    size = np.where(known, G * scale, 0.0)
    ratio = np.linalg.norm(error, axis=(1, 2)) / np.linalg.norm(size, axis=(1, 2))
    return float(np.median(ratio))


def response(reference, omega, outputs):
    """Response (K, ny, nu) of a model or a measured response at omega."""
    if isinstance(reference, StateSpace):
        rows = [reference.outputs.index(name) for name in outputs]
        return reference.response(omega)[:, rows]
    keep = [int(np.argmin(np.abs(reference.omega - value))) for value in omega]
    return reference.G[keep][:, [reference.outputs.index(name) for name in outputs]]


def systems_of(models) -> dict[str, StateSpace]:
    """Structured models as systems."""
    return {name: models[name].model.system() for name in ("TD/FD", "FD only")}


def table(case: Case, models, validation) -> list[str]:
    """Who wins on each output, and by how much."""
    rms = {name: validation.rms[name].mean(axis=0) for name in models}
    lines = [
        f"## {case.name}",
        "",
        f"RMS error on {', '.join(record.name for record in case.unseen)}, mean over records,",
        "and how it compares with that of the FD-only model.",
        "",
        "| output | noise of the records | " + " | ".join(models) + " | TD/FD | all refined |",
        "|---" * (len(models) + 4) + "|",
    ]
    for i, output in enumerate(case.model.outputs):
        values = " | ".join(f"{rms[name][i]:.2g}" for name in models)
        words = " | ".join(verdict(rms[name][i], rms["FD only"][i]) for name in COMBINED)
        lines.append(f"| {output} [{UNITS[output]}] | {NOISE[output]:g} | {values} | {words} |")
    claims = [claim(name, case.model.outputs, rms) for name in ("black box", *COMBINED)]
    return [*lines, "", *claims, "", *frequency_table(case, models), ""]


def verdict(own: float, other: float) -> str:
    """How much smaller an error is than another."""
    return f"{abs(1 - own / other):.0%} {'smaller' if own < other else 'LARGER'}"


def claim(name: str, outputs, rms) -> str:
    """Whether adding time-domain data lowered the error of every output."""
    lost = [i for i in range(len(outputs)) if rms[name][i] >= rms["FD only"][i]]
    if not lost:
        return f"{name}: the paper's claim holds on every output."
    names = ", ".join(
        outputs[i] + (" (below its noise)" if rms[name][i] < NOISE[outputs[i]] else "")
        for i in lost
    )
    return f"{name}: the paper's claim does not hold for {names}; there FD only is better."


def frequency_table(case: Case, models) -> list[str]:
    """Distance of each model's response from the truth."""
    references = [(case.truth_name, case.truth, SixDof.outputs, *case.band)]
    if case.name == "AH-1S":
        references.append(("quasi-steady model", quasi_steady(), (*RATES, *ANGLES), 0.4, 3.0))
    systems = {
        name: found.system if name == "black box" else found.model.system()
        for name, found in models.items()
    }
    lines = [
        "Median relative error of the frequency response:",
        "",
        "| reference | " + " | ".join(systems) + " |",
        "|---" * (len(systems) + 1) + "|",
    ]
    for name, reference, outputs, low, high in references:
        errors = [
            response_error(case, system, reference, outputs, low, high)
            for system in systems.values()
        ]
        cells = " | ".join(f"{error:.1%}" for error in errors)
        lines.append(f"| {name}, {low:g}-{high:g} rad/s | {cells} |")
    return lines


def sources_table(matched: Fit) -> list[str]:
    """What the black box and the measured responses contribute to the match."""
    lines = [
        f"What each source contributes to the H∞ match (norm {matched.cost:.3g}):",
        "",
        "| source | frequencies | weighted entries | largest singular value | share of squares |",
        "|---|---|---|---|---|",
    ]
    for row in matched.notes.sources:
        numbers = f"{len(row.grid)} | {row.entries} | {row.norm:.3g} | {row.share:.0%}"
        lines.append(f"| {row.name} | {numbers} |")
    return [*lines, ""]


# ---- figures ------------------------------------------------------------------------------------


def with_speeds(system: StateSpace) -> StateSpace:
    """The same model with u, v, w for outputs."""
    rows = [system.states.index(name) for name in SPEEDS]
    C, D = np.eye(system.nx)[rows], np.zeros((3, system.nu))
    return replace(system, C=C, D=D, outputs=SPEEDS)


def response_figures(case: Case, models, folder: Path) -> None:
    """Figures 1-8: magnitude and phase, odd ones for col and lat, even ones for ped and lon."""
    systems = systems_of(models)
    number = 0
    for outputs in (FORCES, ANGLES[::-1], RATES, SPEEDS):
        for inputs in (("col", "lat"), ("ped", "lon")):
            number += 1
            figure, axes = plt.subplots(
                2 * len(outputs), 2, figsize=(9, 2.6 * len(outputs) + 1), sharex=True
            )
            for row, output in enumerate(outputs):
                for column, stick in enumerate(inputs):
                    draw_pair(axes[2 * row : 2 * row + 2, column], case, systems, output, stick)
            axes[-1, 0].set_xlabel("ω [rad/s]")
            axes[-1, 1].set_xlabel("ω [rad/s]")
            finish(figure, axes[0, 0], folder / f"figure_{number:02d}.png")


def draw_pair(axes, case: Case, systems, output: str, stick: str) -> None:
    """One pair: truth black, TD/FD grey, FD only dashed."""
    curves = {name: pair_response(system, output, stick) for name, system in systems.items()}
    truth = pair_response(case.truth, output, stick)
    near = None
    if truth is not None:
        near = phase(truth)
        curves = {"truth": truth} | curves
    for name, G in curves.items():
        axes[0].semilogx(OMEGA, decibel(G), label=name, **LINES[name])
        axes[1].semilogx(OMEGA, phase(G, near), **LINES[name])
    axes[0].set_title(f"{output} / {stick}", fontsize=9)
    axes[0].set_ylabel("[dB]")
    axes[1].set_ylabel("[deg]")


def decibel(G):
    """20 log10 |G|."""
    return 20 * np.log10(np.abs(G))


def phase(G, near=None):
    """Phase [deg], unwrapped and moved by whole turns towards ``near``."""
    angle = np.degrees(np.unwrap(np.angle(G)))
    gap = np.median(angle if near is None else angle - near)
    return angle - 360 * np.round(gap / 360)


def pair_response(reference, output: str, stick: str):
    """Response (K,) of one pair on OMEGA; None where the reference has no such output."""
    if output in SPEEDS and isinstance(reference, StateSpace):
        reference = with_speeds(reference)
    if output not in reference.outputs:
        return None
    return response(reference, OMEGA, (output,))[:, 0, reference.inputs.index(stick)]


def history_figures(case: Case, validation, folder: Path) -> None:
    """Figures 9-10: time histories of the first unseen record."""
    for number, outputs in ((9, (*RATES, "theta")), (10, (*FORCES, "phi"))):
        figure, axes = plt.subplots(4, 1, figsize=(9, 9), sharex=True)
        record = case.unseen[0]
        for ax, output in zip(axes, outputs, strict=True):
            i = record.outputs.index(output)
            ax.plot(record.t, record.y[:, i], label="truth", **LINES["truth"])
            for name in ("TD/FD", "FD only"):
                ax.plot(record.t, validation.simulated[name][0][:, i], label=name, **LINES[name])
            ax.set_ylabel(f"{output} [{UNITS[output]}]")
        axes[-1].set_xlabel("t [s]")
        finish(figure, axes[0], folder / f"figure_{number:02d}.png")


def rms_figure(case: Case, validation, folder: Path) -> None:
    """Figure 11: RMS error of each model divided by the largest."""
    figure, ax = plt.subplots(figsize=(9, 3.5))
    rms = np.array([validation.rms[name].mean(axis=0) for name in BARS])
    for k, (name, shade) in enumerate(BARS.items()):
        place = np.arange(rms.shape[1]) + 0.27 * (k - 1)
        ax.bar(place, (rms / rms.max(axis=0))[k], 0.25, color=shade, label=name)
    ax.set_xticks(range(rms.shape[1]), case.model.outputs)
    ax.set_ylabel("RMS error / largest [-]")
    finish(figure, ax, folder / "figure_11.png")


def finish(figure, ax, path: Path) -> None:
    """Legend, grid, file."""
    for each in figure.axes:
        each.grid(visible=True, color="0.9")
        each.spines[["top", "right"]].set_visible(False)
    figure.legend(*ax.get_legend_handles_labels(), ncols=3, loc="upper center", frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 0.96))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(folder: Path) -> None:
    """Both helicopters, figures and report."""
    mpl.use("Agg")
    lines = ["# Time and frequency domain together against the frequency domain alone", ""]
    for case in (uh60(), ah1s()):
        print(f"{case.name} ...", flush=True)
        models, matched = identify(case)
        validation = validate(models, case.unseen)
        place = folder / case.name.lower().replace("-", "")
        place.mkdir(parents=True, exist_ok=True)
        response_figures(case, models, place)
        history_figures(case, validation, place)
        rms_figure(case, validation, place)
        lines += table(case, models, validation) + sources_table(matched)
        better = validation.rms["TD/FD"].mean(axis=0) < validation.rms["FD only"].mean(axis=0)
        assert better.mean() > 0.5, f"{case.name}: TD/FD loses on most outputs"
    (folder / "report.md").write_text("\n".join(lines))
    print("\n".join(lines))
    print(f"Figures and report.md: {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parent / "out" / "paper")
