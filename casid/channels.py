"""Names and units of the channels a rotorcraft usually has."""

UNITS = {
    "ax": "m/s²", "ay": "m/s²", "az": "m/s²",
    "p": "rad/s", "q": "rad/s", "r": "rad/s",
    "phi": "rad", "theta": "rad", "psi": "rad",
    "u": "m/s", "v": "m/s", "w": "m/s",
    "col": "travel", "lat": "travel", "lon": "travel", "ped": "travel",
}  # fmt: skip
CONTROLS = ("col", "lat", "lon", "ped")
