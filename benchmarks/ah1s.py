"""The AH-1S of JSBSim at 80 kn and 2000 ft, flown from Python (`pip install jsbsim`, LGPL).

    python -m benchmarks.ah1s

The wheel contains the aircraft, offered under the GPL or CC-BY-NC-SA. It is flown as for the
records of `examples/ah1s`: rotor at constant speed, no shaping of sticks, no limiter of the yaw
rate, trimmed by Newton's method with the body held until rotor and controls have settled. Run by
itself, it flies the eight 3-2-1-1 of that example and prints how far its records are from them.
"""

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import jsbsim
import numpy as np

from benchmarks.design import FEEDBACK
from casid import Record, read_csv
from casid.design.loop import gains

FOOT, GRAVITY, KNOT = 0.3048, 9.80665, 1852 / 3600
STEP, DT = 0.005, 0.02  # of the simulation and of records [s]
SETTLED = 400  # steps
STICKS = {"col": "collective", "lat": "aileron", "lon": "elevator", "ped": "rudder"}
SEEN = {  # property and its unit
    "ax": ("accelerations/Nx", GRAVITY), "ay": ("accelerations/Ny", GRAVITY),
    "az": ("accelerations/Nz", -GRAVITY), "p": ("velocities/p-rad_sec", 1.0),
    "q": ("velocities/q-rad_sec", 1.0), "r": ("velocities/r-rad_sec", 1.0),
    "phi": ("attitude/phi-rad", 1.0), "theta": ("attitude/theta-rad", 1.0),
}  # fmt: skip
BALANCE = [f"accelerations/{axis}dot-{unit}" for axes, unit in (("uvw", "ft_sec2"),
           ("pqr", "rad_sec2")) for axis in axes]  # fmt: skip
BODY = [f"simulation/integrator/{what}/{way}" for what in ("rate", "position")
        for way in ("rotational", "translational")]  # fmt: skip
CONSTANT = "<ExternalRPM> -1 </ExternalRPM></rotor>"


def simulator():
    """JSBSim with the aircraft, its rotor driven at constant speed."""
    jsbsim.FGJSBBase().debug_lvl = 0
    with TemporaryDirectory() as folder:
        for part in ("aircraft/ah1s", "systems"):
            shutil.copytree(Path(jsbsim.get_default_root_dir()) / part, Path(folder) / part)
        rotor = Path(folder) / "aircraft/ah1s/Engines/ah1s_rotor.xml"
        rotor.write_text(rotor.read_text().replace("</rotor>", CONSTANT))
        made = jsbsim.FGFDMExec(folder)
        made.set_dt(STEP)  # before the model is loaded, whose filters are made for it
        made.load_model("ah1s")
    made["fcs/adj/collective-profile"] = 0.0
    made["fcs/adj/center-sensitivity"] = 1.0
    made["aero/setup/Nr_limiter"] = 0.0
    return made


class Helicopter:
    """In trim; every flight starts there anew."""

    def __init__(self):
        self._sim = simulator()
        self._free = {name: self._sim[name] for name in BODY}
        self._trim = np.array([-0.0343, -0.0251, 0.405, 0.035, 0.104, 0.01])
        for _ in range(8):
            gap = self._rest(self._trim)
            if np.abs(gap).max() < 1e-10:
                break
            slope = [(self._rest(self._trim + d) - gap) / 1e-5 for d in 1e-5 * np.eye(6)]
            self._trim = self._trim - np.linalg.solve(np.transpose(slope), gap)

    def _rest(self, trim):
        """Accelerations (6,) of the held body at θ, φ and four sticks."""
        theta, phi, *sticks = trim
        start = {"theta-rad": theta, "phi-rad": phi, "psi-true-rad": 0.0, "h-sl-ft": 2000.0,
                 "vn-fps": 80 * KNOT / FOOT, "ve-fps": 0.0, "vd-fps": 0.0}  # fmt: skip
        for name, value in start.items():
            self._sim[f"ic/{name}"] = value
        for name in BODY:
            self._sim[name] = 0
        self._sim.run_ic()
        self._sim["propulsion/engine/x-rpm-dict"] = 6600.0
        self._move(sticks)
        for _ in range(SETTLED):
            self._sim.run()
        return np.array([self._sim[name] for name in BALANCE])

    def _move(self, sticks):
        for name, value in zip(STICKS.values(), sticks, strict=True):
            self._sim[f"fcs/{name}-cmd-norm"] = float(value)

    def _seen(self):
        return np.array([unit * self._sim[name] for name, unit in SEEN.values()])

    def fly(self, t, r, inputs, feedback, *, held=False):
        """Record, about the trim, after r (N, nu): straight lines between t (N,), or held."""
        self._rest(self._trim)
        for name, value in self._free.items():
            self._sim[name] = value
        K = gains(feedback, tuple(inputs), tuple(SEEN))
        order = [2 + list(STICKS).index(stick) for stick in inputs]
        y0, u, y = self._seen(), [], []
        for now in STEP * np.arange(round(t[-1] / STEP) + 1):
            seen = self._seen() - y0
            k = np.searchsorted(t, now + 1e-9, side="right") - 1
            line = [np.interp(now, t, column) for column in r.T]
            stick = (r[k] if held else line) - K @ seen
            every = self._trim.copy()
            every[order] += stick
            self._move(every[2:])
            u.append(stick)
            y.append(seen)
            self._sim.run()
        u, y = (np.array(each[:: round(DT / STEP)]) for each in (u, y))
        return Record(DT * np.arange(len(u)), u, y, tuple(inputs), tuple(SEEN))


def main():
    flown, away = Helicopter(), 0.0
    for feedback, kind in (({}, "_open"), (FEEDBACK, "")):
        for stick in STICKS:
            file, channels = f"examples/ah1s/data/3211_{stick}{kind}.csv", {"outputs": list(SEEN)}
            there = read_csv(file, inputs=list(STICKS), detrend="first", **channels)
            r = there.u + there.y @ gains(feedback, tuple(STICKS), tuple(SEEN)).T
            here = flown.fly(there.t, r, tuple(STICKS), feedback, held=True)
            size = np.abs(there.y).max(axis=0)
            away = max(away, float((np.abs(here.y - there.y).max(axis=0) / size).max()))
    print(f"largest difference from the example's records: {away:.1e} of a channel's largest value")


if __name__ == "__main__":
    main()
