"""A study small enough to run in a second or two: roll of a helicopter near hover, simulated."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from casid import Model, Record, Rows, Scalar, parameter, write_csv

MODEL = '''
"""Roll near hover: v' = Yv v + g phi, p' = Lv v + Lp p + Llat lat, phi' = p."""

from casid import Model, Rows, Scalar, parameter


class Roll(Model):
    states, inputs, outputs = ("v", "p", "phi"), ("lat",), ("p", "phi")

    Yv: Scalar = parameter(default=-0.1, lower=-1.0, upper=0.0, unit="1/s")
    Lv: Scalar = parameter(default=-0.1, lower=-1.0, upper=1.0, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-1.5, lower=-10.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=8.0, lower=0.0, upper=50.0, unit="rad/s^2")
    g: float = 9.80665

    def A(self) -> Rows:
        return [[self.Yv, 0, self.g], [self.Lv, self.Lp, 0], [0, 1, 0]]

    def B(self) -> Rows:
        return [[0], [self.Llat], [0]]
'''


class Truth(Model):
    """The same structure with the parameters that made the records."""

    states, inputs, outputs = ("v", "p", "phi"), ("lat",), ("p", "phi")

    Yv: Scalar = parameter(default=-0.12, unit="1/s")
    Lv: Scalar = parameter(default=-0.06, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-2.2, unit="1/s")
    Llat: Scalar = parameter(default=10.0, unit="rad/s^2")

    def A(self) -> Rows:
        return [[self.Yv, 0, 9.80665], [self.Lv, self.Lp, 0], [0, 1, 0]]

    def B(self) -> Rows:
        return [[0], [self.Llat], [0]]


STUDY = """
[study]
title = "Roll near hover"

[model]
file = "roll.py:Roll"

[channels.units]
lat = "%"

[records.identification]
files = ["3211.csv", "sweep.csv"]
noise = true

[records.validation]
files = ["random.csv"]
detrend = "identification"

[noise]
seed = 1
[noise.std]
p = 0.002
phi = 0.002

[pbsid]
order = 3
pole = 4.0
past = 6
future = 6
feedthrough = false

[match]
omega = { from = 0.5, to = 5, points = 20 }
"""

TRIM = {"lat": 0.5, "p": 0.01, "phi": -0.02}


def write_study(
    folder: Path, *changes: tuple[str, str], truth: Model | None = None, v: bool = False
) -> Path:
    """Write model, records of a truth and study; ``changes`` replace text of the study file.

    ``v`` records that state too, with the trim of the others.
    """
    (folder / "roll.py").write_text(MODEL, encoding="utf-8")
    t = np.arange(0, 30, 0.04)
    for name, u in {"3211": _steps(t), "sweep": _sweep(t), "random": _random(t)}.items():
        system, outputs = (truth or Truth()).system(), ("p", "phi")
        if v:
            C = np.vstack([system.C, np.eye(system.nx)[:1]])
            outputs, D = ("p", "phi", "v"), np.zeros((3, 1))
            system = replace(system, C=C, D=D, outputs=outputs)
        y = system.simulate(t, u[:, None])
        trim = TRIM | {"v": 1.5} if v else TRIM
        record = Record(t, u[:, None], y, ("lat",), outputs, name, trim=trim)
        write_csv(folder / f"{name}.csv", record)
        _to_percent(folder / f"{name}.csv")
    text = STUDY
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def _to_percent(path: Path) -> None:
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    cells = [row.split(",") for row in rows]
    lines = [",".join([t, str(100 * float(u)), *rest]) for t, u, *rest in cells]
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")


def _steps(t):
    u = np.zeros_like(t)
    for start, end, sign in ((2, 3.5, 1), (3.5, 4.5, -1), (4.5, 5, 1), (5, 5.5, -1)):
        u[(t >= start) & (t < end)] = 0.05 * sign
    return u


def _sweep(t):
    phase = 2 * np.pi * (0.05 * t + 0.02 * t**2)
    return np.where(t < 2, 0.0, 0.04 * np.sin(phase))


def _random(t):
    levels = np.random.default_rng(7).choice([-0.03, 0.0, 0.03], size=len(t) // 20 + 1)
    return np.repeat(levels, 20)[: len(t)]
