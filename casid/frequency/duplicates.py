"""Whether two measured responses are one measurement: the same numbers, rounded or not."""

from collections.abc import Iterator

import numpy as np

from casid.frequency.covariance import LEAST
from casid.frequency.response import FrequencyResponse

NEARBY = 1e-3  # of a frequency, that rounding makes of it
TOO_CLOSE, FEWEST = 0.1, 3  # stated errors between so many points, for two measurements


def same_numbers(one: FrequencyResponse, other: FrequencyResponse, *, every: bool = False) -> str:
    """What says that two responses hold the same points, in words; "" without such.

    In one of the pairs that both measured or, with ``every``, in all of them. Copies may be
    rounded. Those of known flights, which are others, may state the same leakage.
    """
    told = list(_pairs(one, other))
    return next(filter(None, told), "") if all(told) or not every else ""


def _pairs(one: FrequencyResponse, other: FrequencyResponse) -> Iterator[str]:
    """The same of every pair of which both measured something."""
    known = one.flights() and other.flights()
    place = np.abs(other.omega - one.omega[:, None]).argmin(axis=1)
    close = np.abs(other.omega[place] - one.omega) <= NEARBY * one.omega
    for output in (name for name in one.outputs if name in other.outputs):
        for inp in (name for name in one.inputs if name in other.inputs):
            i, j = one.index(output, inp), other.index(output, inp)
            a, b = one.G[:, *i], other.G[place, *j]
            there = np.isfinite(a * b) & (a * b != 0)  # exact zeros are no measurement
            if not there.any():
                continue
            size = np.maximum(np.hypot(one.error[:, *i], other.error[place, *j]), LEAST) * abs(a)
            off = np.abs(a - b)[close & there] / np.where(there, size, np.nan)[close & there]
            off = off[np.isfinite(off)]
            apart = np.sqrt(np.mean(off**2)) if len(off) >= FEWEST else np.inf
            if (there & (a == b) & (one.omega == other.omega[place])).any():
                yield f"have the same numbers of {output} after {inp}"
            elif apart < TOO_CLOSE and not known:
                yield (
                    f"agree in {output} after {inp} within {apart:.2g} of the errors that they "
                    "state, as one does with its numbers rounded (or errors are stated too large)"
                )
            else:
                yield ""
