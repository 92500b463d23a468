"""Kinematics of a rigid body: what rates and specific forces make of attitudes and velocities."""

from collections.abc import Mapping

import numpy as np

from casid.arrays import Array
from casid.channels import RATES, VELOCITIES
from casid.consistency.measured import Flight

GRAVITY = 9.80665  # m/s^2

Moved = Mapping[str, tuple[Array, Array]]  # channels and their slopes
Terms = tuple[dict[str, Array], Array]  # factors of rates and forces, the rest


def terms_of(equation: str, flight: Flight, turned: Mapping[str, Array] | None = None) -> Terms:
    """Factor of each rate and force in the derivative of an attitude or velocity; the rest.

    ``turned`` are attitudes that stand in for the flight's own.
    """
    n = len(flight.values[equation])
    zero, one = np.zeros(n), np.ones(n)
    known = flight.values if turned is None else turned
    phi, theta = (known.get(name, zero + flight.level.get(name, 0.0)) for name in ("phi", "theta"))
    s, c, tan = np.sin(phi), np.cos(phi), np.tan(theta)
    if equation == "phi":
        return {"p": one, "q": s * tan, "r": c * tan}, zero
    if equation == "theta":
        return {"q": c, "r": -s}, zero
    if equation == "psi":
        return {"q": s / np.cos(theta), "r": c / np.cos(theta)}, zero
    u, v, w = (flight.values[name] for name in VELOCITIES)
    return {
        "u": ({"ax": one, "r": v, "q": -w}, -GRAVITY * np.sin(theta)),
        "v": ({"ay": one, "p": w, "r": -u}, GRAVITY * np.cos(theta) * s),
        "w": ({"az": one, "q": u, "p": -v}, GRAVITY * np.cos(theta) * c),
    }[equation]


def lever_of(moved: Moved) -> Array:
    """L of a_s − a = L r, (3, N, 3), for r from the centre of gravity."""
    (p, dp), (q, dq), (r, dr) = (moved[name] for name in RATES)
    rows = [
        [-(q**2 + r**2), p * q - dr, p * r + dq],
        [p * q + dr, -(p**2 + r**2), q * r - dp],
        [p * r - dq, q * r + dp, -(p**2 + q**2)],
    ]
    return np.moveaxis(np.array(rows), 1, 2)
