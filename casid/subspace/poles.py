"""Laguerre poles worth trying on records, by how fast their outputs move."""

from collections.abc import Sequence

import numpy as np

from casid.record import Record
from casid.samples import usual_interval
from casid.subspace.columns import LONG_GAP, MOVING, input_bandwidth, output_bandwidth
from casid.subspace.laguerre import support

POLES = (1, 1.4, 2, 3, 4, 6, 8)  # of a decade: what poles are chosen from
SPAN = (1.2, 3.6)  # of the outputs' bandwidth: 6 to 14 rad/s for most helicopters
NOISY = 2.0  # times the bandwidth without white noise: what is more is that of the noise
WIDER = 1.5  # upwards, of noisy outputs, in which what moves fast is not seen
PASTS = (8, 10, 12)
COST = 0.25  # of the longest record: what kernels past its end may cost


def _rarest(records: Sequence[Record]) -> float:
    """Interval [s] of the output that is measured most rarely where it is measured most often."""
    rates = []
    for i in range(len(records[0].outputs)):
        own = [record.t[np.isfinite(record.y[:, i])] for record in records]
        rates.append(min((usual_interval(t) for t in own if len(t) > 1), default=0.0))
    return max(rates)


def clear_bandwidth(records: Sequence[Record]) -> tuple[float, bool]:
    """Bandwidth [rad/s] of the outputs' motion, and whether that of most is their white noise's.

    What is white at the highest frequencies of samples is noise if inputs have little power there.
    """
    whole, quiet = output_bandwidth(records), output_bandwidth(records, quiet=True)
    slow = input_bandwidth(records, MOVING) < 0.5 * np.pi / max(record.dt for record in records)
    return (quiet, True) if slow and whole > NOISY * quiet else (whole, False)


def usable_poles(records: Sequence[Record]) -> list[float]:
    """Laguerre poles [rad/s] worth trying: somewhat faster than the outputs move.

    Their kernels cost at most a quarter of the longest record, and their band is sampled, else
    records are too short for how slowly they are sampled: ValueError. Where that leaves any, the
    samples of an output at a lower rate are no gaps to them.
    """
    longest = max(record.duration for record in records)
    slowest = support(1.0, min(PASTS)) / (COST * longest)
    fastest = 0.5 * np.pi / max(record.dt for record in records)
    whole = LONG_GAP / max(_rarest(records), 1e-300)
    if slowest <= whole < fastest:
        fastest = whole
    if slowest > fastest:
        raise ValueError(
            f"records of {longest:.3g} s sampled every {records[0].dt:.3g} s suit no Laguerre "
            "pole: kernels short enough are not sampled; give longer records or faster sampling, "
            "or name the pole, past and order"
        )
    bandwidth, noisy = clear_bandwidth(records)
    span = SPAN[0], SPAN[1] * (WIDER if noisy else 1.0)
    low, high = np.clip(np.array(span) * bandwidth, slowest, fastest)
    ratio = SPAN[1] / SPAN[0]
    high = max(high, min(ratio * low, fastest))
    low = min(low, max(high / ratio, slowest))
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    grid = [float(f"{first}e{decade}") for decade in decades for first in POLES]
    return [a for a in grid if low <= a <= high] or [float(np.sqrt(low * high))]
