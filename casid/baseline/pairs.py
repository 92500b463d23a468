"""Which points of a measured response a fit uses, and how much each counts in its cost J."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

from casid.arrays import BoolArray
from casid.frequency.response import FrequencyResponse
from casid.matching.comparison import Comparison, Source
from casid.matching.mismatch import DB, pair_weights
from casid.matching.targets import in_channels
from casid.model import Model
from casid.nonlinear.conditions import by_condition, told_at

Pair: TypeAlias = tuple[str, str]
Pairs: TypeAlias = Sequence[Pair] | Mapping[Pair, tuple[float, float] | None]

FEWEST = 5  # points with coherence that make a pair worth fitting


def select(
    model: Model, frf: FrequencyResponse, pairs: Pairs | None = None, coherence: float = 0.6
) -> Comparison:
    """The response in the model's channels; its mean square error is J to first order."""
    names = frf.outputs, frf.inputs
    G = in_channels(model, *names, frf.G)
    gamma = in_channels(model, *names, frf.coherence)
    gamma = np.where(np.isfinite(gamma), gamma, 0.0)
    known = np.isfinite(G) & (np.abs(G) > 0) & (gamma > 0)  # without coherence nothing weighs
    conditions = by_condition(model.outputs)
    for condition, rows in conditions.items():
        if (np.isnan(G) | (G == 0))[:, rows].all() and (pairs is None or len(conditions) == 1):
            raise ValueError(told_at(condition) + _nothing_known(model, frf))
    if pairs is None:
        used = known & (gamma >= coherence)
        used &= used.sum(axis=0) >= min(FEWEST, len(frf.omega))
        for condition, rows in conditions.items():
            if not used[:, rows].any():
                raise ValueError(
                    f"{told_at(condition)}no pair has coherence >= {coherence:g} at {FEWEST} "
                    "frequencies; lower the threshold, name the pairs, or improve the response"
                )
    else:
        used = known & _named(model, frf, pairs, known)
    scale = [frf.input_std[frf.inputs.index(n)] if n in frf.inputs else 1.0 for n in model.inputs]
    weight = pair_weights(gamma, used) * len(frf.omega)
    W = np.sqrt(weight) * DB / np.where(used, np.abs(G), 1.0)
    source = Source.measured(frf.omega, np.where(used, G, 0.0), W)
    band = float(frf.omega[0]), float(frf.omega[-1])
    return Comparison(sources=(source,), input_scale=np.array(scale), band=band, shift=0.0)


def _nothing_known(model: Model, frf: FrequencyResponse) -> str:
    """Why no pair of the model was measured, and the remedy."""
    if np.isfinite(frf.G).any() and (lacking := missing_channels(model, frf)):
        return f"no pair of the model was measured: {lacking}"
    why = "; ".join(frf.flags) or "all are NaN or zero"
    return (
        f"no point of the measured response is known ({why}); mend the records that it was "
        "estimated from, or ask for other frequencies"
    )


def missing_channels(model: Model, frf: FrequencyResponse) -> str:
    """What the model has that a response does not, and the remedy; empty where there is none."""
    said = []
    for kind, wanted, known in (
        ("input", model.inputs, frf.inputs),
        ("output", model.outputs, frf.outputs),
    ):
        if missing := [repr(name) for name in wanted if name not in known]:
            said.append(f"the response has no {kind} {', '.join(missing)}, but {', '.join(known)}")
    return "; ".join([*said, "rename channels, or leave them out of the model"]) if said else ""


def left_out(frf: FrequencyResponse, comparison: Comparison, model: Model) -> list[Pair]:
    """Pairs of the model that were measured, but of which no point is fitted."""
    measured = np.isfinite(in_channels(model, frf.outputs, frf.inputs, frf.G)).any(axis=0)
    unused = measured & ~(comparison.W > 0).any(axis=0)
    return [(model.outputs[i], model.inputs[j]) for i, j in np.argwhere(unused)]


def _named(model: Model, frf: FrequencyResponse, pairs: Pairs, known: BoolArray) -> BoolArray:
    """Where the caller's pairs are in their ranges."""
    chosen = np.zeros(known.shape, dtype=bool)
    ranges = pairs if isinstance(pairs, Mapping) else dict.fromkeys(map(tuple, pairs), None)
    for pair, limits in ranges.items():
        if len(pair) != 2:
            raise ValueError(f'pairs holds {pair!r}, expected (output, input): [("p", "lat")]')
        output, name = pair
        frf.index(output, name)
        if output not in model.outputs or name not in model.inputs:
            raise ValueError(
                f"pair ({output!r}, {name!r}) is not in the model: outputs are "
                f"{', '.join(model.outputs)}, inputs are {', '.join(model.inputs)}"
            )
        low, high = limits or (0.0, np.inf)
        inside = (frf.omega >= low) & (frf.omega <= high)
        i, j = model.outputs.index(output), model.inputs.index(name)
        if not (inside & known[:, i, j]).any():
            raise ValueError(
                f"pair ({output!r}, {name!r}) was not measured between {low:g} and {high:g} "
                "rad/s (no coherence there); leave it out or widen its range"
            )
        chosen[inside, i, j] = True
    if not chosen.any():
        raise ValueError("pairs is empty; name at least one (output, input), or leave it out")
    return chosen


def thin(frf: FrequencyResponse, n_omega: int) -> FrequencyResponse:
    """The points nearest to n_omega log-spaced ones."""
    wanted = np.geomspace(frf.omega[0], frf.omega[-1], n_omega)
    distance = np.abs(np.log(frf.omega[:, None] / wanted))
    return frf.take(np.unique(np.argmin(distance, axis=0)))
