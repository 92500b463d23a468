"""Other open implementations, in an environment of their own, on the same data in the same run.

They are SIPPY (`sippy_unipi`: N4SID, MOESP, CVA, PARSIM-K, -S, -P) and `nfoursid`. CASID_PEERS
names a Python that has them; otherwise the first call builds one in `benchmarks/.peers` from PyPI.
"""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from casid import StateSpace

HERE = Path(__file__).resolve().parent
PACKAGES = ("sippy_unipi==1.0.1", "nfoursid==1.0.2")
METHODS = ("N4SID", "MOESP", "CVA", "PARSIM-K", "PARSIM-S", "PARSIM-P", "nfoursid")


@dataclass(frozen=True, eq=False)
class PeerModel:
    """A discrete model, its gain (0 if it has none) and the seconds it took to identify it."""

    system: StateSpace
    K: np.ndarray
    seconds: float


def interpreter():
    """The peers' Python, installed if need be."""
    if named := os.environ.get("CASID_PEERS"):
        return Path(named)
    python = HERE / ".peers" / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", HERE / ".peers"], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    return python


def identify(u, y, orders, *, horizon, feedthrough, dt=1.0, methods=METHODS):
    """PeerModel by (method, order); a method that fails on an order is left out."""
    with tempfile.TemporaryDirectory() as folder:
        problem, answer = Path(folder) / "problem.npz", Path(folder) / "answer.npz"
        np.savez(problem, u=u, y=y, orders=np.array(list(orders)), horizon=horizon,
                 feedthrough=feedthrough, methods=np.array(methods))  # fmt: skip
        command = [interpreter(), HERE / "peer_worker.py", problem, answer]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        found, models = np.load(answer), {}
        for key in found.files:
            method, order, what = key.split("|")
            if what == "seconds":
                A, B, C, D, K = (found[f"{method}|{order}|{letter}"] for letter in "ABCDK")
                models[method, int(order)] = PeerModel(
                    StateSpace(A, B, C, D, dt), K, float(found[key])
                )
        return models
