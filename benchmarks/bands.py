"""Do bands of the response hold the true one where the structure is not all, how wide are they?

The ten cases of `benchmarks.ten_cases`: output error on the four 3-2-1-1, its band from standard
errors alone and with the structure's error. The true response is AW109's linearisation, and of
UH-60 and AH-1S the best linear approximation of the noise-free records (a long ARX model). Then
three campaigns of a structure that is true (`benchmarks.enough`), where the structure's error
should hardly widen the band.

    OMP_NUM_THREADS=1 python -m benchmarks.bands AW109 [--noise TIMES] [--seed S] [--kept FILE]
        [--only WORDS]

AW109 has the folders 040kt, 060kt, 080kt, and beside it the folder models their linearisations,
aw109_040kt.json ... What FILE (JSON lines) holds is not computed again.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.enough import truth
from benchmarks.tables import table
from benchmarks.ten_cases import KNOTS, SETTINGS, Case, best, folder_of
from benchmarks.uh60 import NOISE, OMEGA, STEPS, SWEEPS, long_autoregression
from casid import StateSpace, output_error, pbsid, response_band, structure_error
from models.hybrid_flap import HybridFlap
from models.six_dof import SixDof

HELICOPTERS = ("UH-60", "AH-1S", *(f"AW109 {speed}" for speed in KNOTS))
TRUE = ("UH-60, SixDof", "UH-60, HybridFlap", "AH-1S, SixDof")


def true_response(case: Case, helicopter: str, data: Path):
    """(K, ny, nu) on `OMEGA`."""
    if helicopter.startswith("AW109"):
        folder = data.parent / "models"
        content = json.loads((folder / f"aw109_{helicopter[-5:]}.json").read_text())
        A, B, C, D = (np.array(content[name], dtype=float) for name in "ABCD")
        # Sticks there in % of travel, here as shares of it.
        return StateSpace(A, 100 * B, C, 100 * D).response(OMEGA)
    return long_autoregression(case.read(folder_of(helicopter), (*STEPS, *SWEEPS), "first"))


def held(fit, box, G):
    """Shares of points inside, magnitude and phase, and median widths, of both bands."""
    usable = (box.band[0] <= OMEGA) & (box.band[1] >= OMEGA)
    omega, G = OMEGA[usable], G[usable]
    found = {}
    for name, error in (("parametric", None), ("with structure", structure_error(fit, box))):
        band = response_band(fit, omega, error=error)
        low, high = band.magnitude()
        inside = (low <= np.abs(G)) & (np.abs(G) <= high)
        half = np.ptp(band.phase(), axis=0) / 2
        turned = np.abs(np.angle(G / band.G)) <= half
        found[name] = {
            "inside": float((inside.mean() + turned.mean()) / 2),
            "magnitude": float(inside.mean()),
            "phase": float(turned.mean()),
            "width": float(np.median((high - low) / np.abs(band.G)) / 2),
        }
    return found


def records(helicopter: str, structure, asked: argparse.Namespace):
    """One of the ten cases."""
    case = Case(helicopter, structure, asked.data, asked.seed, asked.noise)
    fit = best(lambda: case.refined(4, "time"))
    return held(fit, case.box(), true_response(case, helicopter, asked.data))


def campaign(name: str, asked: argparse.Namespace):
    """One campaign of a structure that is true."""
    model, flown = truth(name, asked.data)
    rng = np.random.default_rng([asked.seed, 60])
    noise = {output: asked.noise * std for output, std in NOISE.items()}
    noisy = [record.with_noise(noise, rng) for record in flown]
    fit = best(lambda: output_error(model, [record.decimate(2) for record in noisy[: len(STEPS)]]))
    return held(fit, pbsid(noisy, **SETTINGS), model.system().response(OMEGA))


def show(done):
    """What is held and how wide it is."""
    rows = []
    for key, row in done.items():
        plain, both = row["parametric"], row["with structure"]
        share = [f"{100 * each['inside']:.0f} %" for each in (plain, both)]
        wide = [f"{100 * each['width']:.0f} %" for each in (plain, both)]
        known = plain["width"] > 1e-6  # not of a fit without standard errors
        rows.append([key, *share, *wide, f"{both['width'] / plain['width']:.2f}" if known else "-"])
    heading = ("case", "held by errors alone", "with structure", "half width", "with", "ratio")
    print(table(heading, rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--noise", type=float, default=1.0, help="times the usual")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kept", type=Path, default=Path("bands.jsonl"))
    parser.add_argument("--only", default="", help="words that a case must have")
    chosen = parser.parse_args()
    lines = chosen.kept.read_text().splitlines() if chosen.kept.exists() else []
    done = {row["key"]: row for row in map(json.loads, lines)}
    cases = {
        f"{name}, {each.__name__}": (lambda n=name, s=each: records(n, s, chosen))
        for name in HELICOPTERS
        for each in (SixDof, HybridFlap)
    }
    cases |= {f"true: {name}": (lambda n=name: campaign(n, chosen)) for name in TRUE}
    for key, compute in cases.items():
        whole = f"{key}, noise {chosen.noise:g}, {chosen.seed}"
        if whole not in done and all(word in key for word in chosen.only.split()):
            done[whole] = {"key": whole} | compute()
            with chosen.kept.open("a") as file:
                file.write(json.dumps(done[whole]) + "\n")
    show(done)


if __name__ == "__main__":
    main()
