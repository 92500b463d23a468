"""What does it cost to believe in theory? Six degrees of freedom of the UH-60 under four beliefs.

The same structure is fitted to the same records four times: within its own bounds, with the signs
of the linearised derivatives, with the ties that flapping and tail-rotor theory set between
derivatives, and within ±20 % of the linearised values, as one would hold them to a wind tunnel's.
The multiplier of every bound prices it: the table says which belief the records contradict most.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casid import compare_bounds, read_records, read_study, report

ROOT = Path(__file__).parent.parent
OUT = ROOT / "out" / "bounds"


def linearised(model):
    """The structure at the derivatives of the simulation's 8-state linearisation."""
    source = json.loads((ROOT / "examples/uh60/uh60_genhel_080kt.json").read_text())
    bare = replace(model, **dict.fromkeys(model.parameter_names(), 0.0)).system().A
    A = np.array(source["A8"]) - bare  # what is not trim or gravity
    B = 100 * np.array(source["B8"])[:, [2, 0, 1, 3]]  # per % of lat, lon, col, ped
    values = {
        force + motion: float(A[i, j])
        for i, force in enumerate("XYZLMN") for j, motion in enumerate("uvwpqr")
    } | {
        force + stick: float(B[i, j])
        for i, force in enumerate("XYZLMN") for j, stick in enumerate(model.inputs)
    }  # fmt: skip
    return replace(model, **values)


def start_of(study, records):
    """The quadratic match to the black box: where output error starts."""
    black_box = study.settings["pbsid"].fit(records["identification"])
    quadratic = replace(study.settings["match"], norm="quadratic")
    return quadratic.fit(study.model, black_box)


def main():
    study = read_study(ROOT / "examples/uh60/study.toml")
    records = read_records(study)
    guess = linearised(study.model)
    derivatives = [name for name in guess.parameter_names() if not name.startswith("tau")]
    cases = {
        "free": {},
        "signs": {name: "> 0" if getattr(guess, name) > 0 else "< 0" for name in derivatives},
        # The tilted rotor's moments about both axes are equal, hence derivatives go as 1/Ixx and
        # 1/Iyy, 5629 and 40000 slug ft²; the tail rotor pushes 9.9 m behind the centre of gravity.
        "theory": ["Lp = 7.1 Mq", "Lq = -7.1 Mp", "Nped = -1.42 Yped"],
        "±20 %": dict.fromkeys(derivatives, "±20 %"),
    }
    comparison = compare_bounds(
        guess, records["refinement"], cases=cases, start=start_of(study, records),
        validation=records["validation"], estimator=study.settings["output_error"],
    )  # fmt: skip
    comparison.to_csv(OUT / "bounds.csv")
    figure = Figure(figsize=(7.4, 8), layout="constrained")
    report.plot_bounds(figure.subplots(), comparison)
    figure.savefig(OUT / "bounds.png", dpi=150)
    print(comparison.to_markdown())

    for case in comparison.cases:
        assert case.reason == ""
        assert case.increase >= 0  # a bound never helps
        assert 0.3 < (case.predicted + 1e-9) / (case.increase + 1e-9) < 3
    assert comparison["±20 %"].held > 10


if __name__ == "__main__":
    main()
