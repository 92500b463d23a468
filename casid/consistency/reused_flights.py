"""Flights that serve twice: recognised by what was measured, whatever the records are called."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from casid.record import Record
from casid.samples import known_mean

GRAIN = 1e-4  # of a channel's standard deviation: measurements nearer than that are the same
SHARED = 0.5  # of a record's different samples: more of them in another make it the same flight


@dataclass(frozen=True, kw_only=True)
class Repeats:
    """Flights that serve twice."""

    seen: Mapping[str, str] = field(default_factory=dict)  # by an estimation
    twice: tuple[tuple[str, str], ...] = ()  # records of one role that are one flight

    def told(self) -> list[str]:
        """A sentence for each of them."""
        said = []
        for name, other in self.seen.items():
            same = "" if name == other else f" (as {other})"
            said.append(
                f"Record {name} is for validation, but an estimation has seen it{same}: its "
                "verdict is no proof."
            )
        for names in self._flights():
            n = len(names)
            said.append(
                f"Records {', '.join(names[:-1])} and {names[-1]} are the same flight: it counts "
                f"{'twice' if n == 2 else f'{n} times'}, and standard errors come out too small by "
                f"up to √{n}; leave one of them in."
            )
        return said

    def _flights(self) -> list[list[str]]:
        """Records of one role by the flight that they are."""
        found: list[list[str]] = []
        for pair in self.twice:
            joined = [names for names in found if not {*pair}.isdisjoint(names)]
            found = [names for names in found if names not in joined]
            found.append(
                list(dict.fromkeys([name for names in joined for name in names] + [*pair]))
            )
        return found


def repeats(roles: Mapping[Any, Sequence[Record]]) -> Repeats:
    """Which records of these roles, as measured, are pieces of the same flight."""
    # Samples are compared in all channels together, trim included and time left out, so that a
    # copy, a piece and a file of another format or precision are recognised; and less their means,
    # so that a copy is whose trim was removed before. Those of "validation" are to be new.
    every = {(role, r.name): r for role, records in roles.items() for r in records}
    prints = dict(zip(every, _fingerprints(list(every.values())), strict=True))
    centred = dict(zip(every, _fingerprints(list(every.values()), centred=True), strict=True))
    seen: dict[str, str] = {}
    twice: dict[tuple[str, str], None] = {}
    for (role, name), own in prints.items():
        for (other_role, other), theirs in prints.items():
            alike = _alike(own, theirs) or _alike(centred[role, name], centred[other_role, other])
            if not alike or (role, name) == (other_role, other):
                continue
            if role == "validation" != other_role:
                seen.setdefault(name, other)
            elif role == other_role and (other, name) not in twice:
                twice[name, other] = None
    return Repeats(seen=seen, twice=tuple(twice))


def _alike(own: set[bytes], theirs: set[bytes]) -> bool:
    return len(own & theirs) > SHARED * min(len(own), len(theirs))


def _fingerprints(records: Sequence[Record], *, centred: bool = False) -> list[set[bytes]]:
    """The different samples of every record, ``centred`` less their mean, rounded alike in all."""
    tables = []
    for record in records:
        names = (*record.inputs, *record.outputs)
        offset = np.array([record.trim.get(name, 0.0) for name in names])
        table = np.column_stack([record.u, record.y])
        tables.append(table - known_mean(table) if centred else table + offset)
    scale: dict[int, np.ndarray] = {}
    for width in {table.shape[1] for table in tables}:
        size = np.nanstd(np.vstack([each for each in tables if each.shape[1] == width]), axis=0)
        scale[width] = np.where(size > 0, GRAIN * size, 1.0)
    grains = [np.floor(table / scale[table.shape[1]] + 0.5) for table in tables]
    whole = [np.nan_to_num(table, nan=-(2.0**60)) + 0.0 for table in grains]
    found = [{row.tobytes() for row in table} for table in whole]
    return [rows if len(rows) > 1 or not centred else set() for rows in found]  # all at rest
