"""Designs for aircraft other than the AH-1S, with right and wrong priors, flown nonlinearly.

    python -m benchmarks.design_aircraft [bo105 uh60] [--priors 0 1 2 3 4]

Truths are `RigidBody` with the derivatives of the Bo105 of `bo105.py`, and with those of the UH-60
of `uh60.py` once all faster states have settled, each in a loop of its own. Four 3-2-1-1, one a
stick, 20 s each, are flown in it; so is a design of 80 s, whose sticks, rates and responses have
the limits of `design.py`: largest deviation and edge of these, 1.5 times the largest response.

Prior 0 is right, of another every derivative is 30 % wrong, up or down at random. The gain is over
the 3-2-1-1 as they were flown, which know no prior; the share of it that is left is that over the
gain with the right prior. On equal terms it is that over the 3-2-1-1 that the design itself was
compared with, in the same time and as large as the same prior lets them be. A prior with which
nothing could be flown is refused; how is printed.
"""

import argparse
import json
import time
from dataclasses import dataclass, fields, replace

import numpy as np

from benchmarks import bo105, uh60
from benchmarks.design import DT, NOISE, TIMES, errors_of, limits, moved, peaks, rates, rigid
from benchmarks.tables import against, cell, table
from casid import DesignSettings, design_inputs
from models.rigid_body import RigidBody
from models.six_dof import SixDof

LENGTH = 20.0  # of a 3-2-1-1 [s]
KEPT = 0.75  # of the gain


@dataclass(frozen=True, eq=False)
class Aircraft:
    """Derivatives, the loop u = r - K y, and the 3-2-1-1 that are flown in it, (N, 4) each."""

    linear: SixDof
    feedback: dict[str, dict[str, float]]
    pilots: list[np.ndarray]

    @property
    def model(self):
        return RigidBody(**{each.name: getattr(self.linear, each.name) for each in fields(SixDof)})

    def fly(self, r):
        """Deviations from trim after a designed input."""
        model = self.model
        record = rigid(DT * np.arange(len(r)), r, model.inputs, model, self.feedback)
        return replace(record, y=record.y - record.y[0])


def padfields(t):
    feedback = {}
    for (stick, output), gain in bo105.FEEDBACK.items():
        feedback.setdefault(stick, {})[output] = gain
    pilots = [bo105.reference(stick, 1.0, DT, len(t)) for stick in SixDof.inputs]
    return Aircraft(bo105.truth(), feedback, pilots)


def blackhawk(t):
    """Sticks in the units of its records; the faster states answer at once, 50 ms late."""
    whole = uh60.oracle()
    slow, fast = slice(0, 8), slice(8, None)
    settled = np.linalg.solve(whole.A[fast, fast], np.hstack([whole.A[fast, slow], whole.B[fast]]))
    both = np.hstack([whole.A[slow, slow], whole.B[slow]]) - whole.A[slow, fast] @ settled
    trim = json.loads(uh60.ORACLE.read_text())["trim_x0_ftlb"]
    (U0, V0, W0), theta0 = 0.3048 * np.array(trim[:3]), trim[7]
    bare = SixDof(U0=U0, V0=V0, W0=W0, theta0=theta0)
    bare = bare.with_vector(np.zeros(len(bare.vector())))
    rest = np.hstack([bare.system().A, bare.system().B])
    columns = (*SixDof.states, *SixDof.inputs)
    values = {
        f"{force}{name}": float((both - rest)[i, columns.index(name)])
        for i, force in enumerate("XYZLMN") for name in (*SixDof.states[:6], *SixDof.inputs)
    }  # fmt: skip
    delays = {f"tau_{stick}": 0.05 for stick in SixDof.inputs}
    feedback = {"lat": {"p": 5.0, "phi": 15.0}, "lon": {"q": 20.0, "theta": 25.0},
                "ped": {"r": 20.0}}  # fmt: skip
    sizes = {"col": 4.0, "lat": 4.0, "lon": 2.5, "ped": 5.0}
    pilots = [
        size * np.outer(uh60.steps(t, stick), np.eye(4)[j])
        for j, (stick, size) in enumerate(sizes.items())
    ]
    return Aircraft(replace(bare, **values, **delays), feedback, pilots)


def row(aircraft, four, prior):
    """Gains and shares of limits with one prior."""
    tops, fastest = peaks(four), rates(four)
    believed = moved(aircraft.model, prior) if prior else aircraft.model
    begin = time.process_time()
    made = design_inputs(
        believed, limits(tops, fastest, True), len(four) * LENGTH, noise=NOISE,
        feedback=aircraft.feedback, settings=DesignSettings(method="steps", dt=DT),
    )  # fmt: skip
    seconds = time.process_time() - begin
    flown = [aircraft.fly(r) for r in (made.r, made.alternatives[0].r)]
    bought, *mine = (
        errors_of(aircraft.linear, each, aircraft.feedback) for each in (four, flown[:1], flown[1:])
    )
    ratio, terms = mine[0] / bought, mine[0] / mine[1]
    seen, fast = peaks(flown[:1]), rates(flown[:1])
    shares = [max(seen[n] / tops[n] for n in names) for names in (SixDof.inputs, SixDof.outputs)]
    return {
        "mean": mean(ratio), "worst": float(ratio.max()), "of": made.names[int(ratio.argmax())],
        "terms": mean(terms), "sticks": shares[0], "responses": shares[1],
        "rates": max(fast[n] / fastest[n] for n in fastest), "seconds": seconds,
    }  # fmt: skip


def mean(ratio):
    return float(np.exp(np.log(ratio).mean()))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("aircraft", nargs="*", default=["bo105", "uh60"])
    parser.add_argument("--priors", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    options = parser.parse_args()
    t, rows = DT * np.arange(round(LENGTH / DT) + 1), []
    for name in options.aircraft:
        aircraft = {"bo105": padfields, "uh60": blackhawk}[name](t)
        four, right = [aircraft.fly(r) for r in aircraft.pilots], None
        for prior in options.priors:
            try:
                told = row(aircraft, four, prior)
            except ValueError as error:  # a prior with which it could not be flown
                print(f"{name}, prior {prior}: {error}", flush=True)
                continue
            right = right or told
            kept = [right[key] / told[key] for key in ("mean", "terms")]
            ratios = [cell(told["mean"]), cell(told["worst"])]
            if not prior:
                ratios = [against(told["mean"], 0.4), against(told["worst"], 0.6)]
            rows.append([
                name, prior, *ratios, told["of"],
                *(against(x, KEPT, above=True) if prior else cell(x) for x in kept),
                told["sticks"], told["rates"], against(told["responses"], TIMES), told["seconds"],
            ])  # fmt: skip
    header = ["aircraft", "prior", "geometric mean", "worst", "of", "of the gain left",
              "on equal terms", "sticks over those of 3-2-1-1", "their rates", "responses",
              "seconds"]  # fmt: skip
    print(table(header, rows))


if __name__ == "__main__":
    main()
