"""Which manoeuvres may be left out: those without which the others still move every input."""

from collections.abc import Collection, Sequence
from itertools import chain

import numpy as np

from casid.arrays import Array
from casid.checks import check_known
from casid.errors import warn
from casid.free import free_parameters
from casid.model import Bounds, Model
from casid.nonlinear.model import NonlinearModel
from casid.record import Record

HARDLY = 0.05  # of an input's largest reach in a record: records of less tell nothing of it
FEWEST = 2  # manoeuvres, or groups of them, that are left out


def told_by(
    model: Model,
    inputs: Sequence[str],
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
) -> list[str]:
    """Free parameters of a linear structure that change nothing but what these inputs do."""
    if not inputs:
        return []
    free, rng = free_parameters(model, fixed, bounds), np.random.default_rng(0)
    values, read = model.vector(), model.matrices()
    others = [k for k, name in enumerate(model.inputs) if name not in inputs]

    def felt(vector: Array) -> list[Array]:
        A, B, C, D, tau, sensors = (each.full() for each in read(vector))
        return [A, B[:, others], C, D[:, others], tau.ravel()[others], sensors]

    found = []
    size = np.maximum(np.abs(values), 1e-3)
    away = values + rng.uniform(0.1, 0.2, len(values)) * size  # where no product is zero
    for name, k in zip(free.names, free.index, strict=True):
        moved = away.copy()
        moved[k] += 0.1 * size[k]
        if all(map(np.array_equal, felt(away), felt(moved))):
            found.append(name)
    return found


def needed(model: Model, fixed: Collection[str] = (), bounds: Bounds | None = None) -> list[str]:
    """Inputs that alone tell some free parameter; all of a nonlinear structure."""
    if isinstance(model, NonlinearModel):
        return list(model.inputs)
    return [name for name in model.inputs if told_by(model, [name], fixed, bounds)]


def unmoved(
    records: Sequence[Record], names: Collection[str], inputs: Sequence[str]
) -> tuple[str, ...]:
    """Inputs that hardly move in any record but those named, in which they do."""
    reach = {True: np.zeros(len(inputs)), False: np.zeros(len(inputs))}
    for record in records:
        own = np.array([np.ptp(record.channel(name)) for name in inputs])
        reach[record.name in names] = np.maximum(reach[record.name in names], own)
    return tuple(np.array(inputs)[reach[False] < HARDLY * reach[True]].tolist())


def told_unmoved(records: Sequence[Record], inputs: Sequence[str]) -> str:
    """Which records hold what moves an input, each alone; "" if none does."""
    lone = {each.name: unmoved(records, {each.name}, inputs) for each in records}
    said = [f"without {name} nothing moves {', '.join(own)}" for name, own in lone.items() if own]
    return "; ".join(said)


def parts_of(
    groups: Sequence[Collection[str]] | None, records: Sequence[Record], inputs: Sequence[str]
) -> list[tuple[int, ...]]:
    """Places of the records of every group; ValueError for names of none and groups of all."""
    names = [each.name for each in records]
    if groups is None:
        return _one_by_one(records, inputs)
    check_known("no manoeuvre is called", chain.from_iterable(groups), names)
    parts = [tuple(i for i, name in enumerate(names) if name in group) for group in groups]
    if len(parts) < FEWEST or any(len(part) in {0, len(records)} for part in parts):
        raise ValueError("groups: expected two or more, none of them empty or of all manoeuvres")
    if len(set(chain.from_iterable(parts))) < sum(map(len, parts)):
        raise ValueError("groups: a manoeuvre is in two of them, and would count twice")
    for group in groups:
        if own := unmoved(records, group, inputs):
            raise ValueError(
                f"groups: without {', '.join(group)} nothing moves {', '.join(own)}, so a fit to "
                "the others cannot tell what they do; group the manoeuvres differently, or leave "
                "these in"
            )
    return parts


def _one_by_one(records: Sequence[Record], inputs: Sequence[str]) -> list[tuple[int, ...]]:
    """Places of the records without which the others move every input, each by itself."""
    parts: list[tuple[int, ...]] = [
        (i,) for i, each in enumerate(records) if not unmoved(records, {each.name}, inputs)
    ]
    if len(parts) < len(records):
        told = told_unmoved(records, inputs)
        if len(parts) < FEWEST:
            raise ValueError(f"each manoeuvre is left out in turn, but {told}; fly each axis twice")
        warn(
            f"{told}: manoeuvres that nothing replaces are not left out, and candidates are not "
            "judged by them; fly each axis twice"
        )
    return parts
