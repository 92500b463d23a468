"""Units of a log's channels: what it states, what the user states, what is taken."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from casid.channels import MEASURES, UNITS, factor_of
from casid.logs.conventions import OUTPUTS, Source
from casid.logs.topics import SI_OF, SPELT


def with_units(sources: Mapping[str, Source], stated: Mapping[str, str]) -> dict[str, Source]:
    """Sources by channel, those of which the user states the unit read by that."""
    found = dict(sources)
    for name in stated.keys() & sources.keys():
        source = sources[name]
        unit = SPELT.get(stated[name], stated[name])
        factor = factor_of(name, unit) / SI_OF.get(source.unit or "", 1.0)
        found[name] = replace(source, values=factor * source.values, unit=unit)
    return found


def check_units(path: Path, sources: Mapping[str, Source]) -> list[str]:
    """What is taken where no known unit is stated, a sentence each.

    ValueError: an output in a unit that is none of its quantity's, wrong by any factor.
    """
    said = []
    for name, source in sources.items():
        if source.unit is None:
            continue
        if name not in OUTPUTS:
            if source.unit == "":
                said.append(f"unit of {name} not stated: taken as it is")
            elif source.unit not in SI_OF:
                said.append(f"unit of {name}, {source.unit!r}, is not known: taken as it is")
        elif source.unit == "":
            said.append(f"unit of {name} not stated: taken as {UNITS[name]}")
        elif SPELT.get(source.unit, source.unit) not in (known := MEASURES[UNITS[name]]):
            raise ValueError(
                f"{path}: column {source.place}, of {name}, is in {source.unit!r}, which is none "
                f"of {', '.join(known)}; state what it is: --unit {name}=UNIT "
                f"(units={{{name!r}: ...}}), or convert the column"
            )
    return said
