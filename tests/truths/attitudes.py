"""Attitude after a stick through a lag and a delay, as if measured without error."""

import numpy as np

from casid import FrequencyResponse

OMEGA = np.geomspace(0.1, 40.0, 800)


def response(function, omega=OMEGA, coherence=1.0, name="phi"):
    G = np.asarray(function(1j * omega), dtype=complex)[:, None, None]
    return FrequencyResponse(
        omega=omega, G=G, coherence=np.full(G.shape, coherence), random_error=np.zeros(G.shape),
        inputs=("lat",), outputs=(name,), input_std=np.ones(1), output_std=np.ones(1),
    )  # fmt: skip


def roll(s, lag=0.3, delay=0.1):
    return 5 * np.exp(-delay * s) / (s * (lag * s + 1))
