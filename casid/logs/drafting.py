"""A study drafted from a log: records of its lively stretches, a structure to start from."""

import json
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from casid.channels import AIR, ATTITUDES, FORCES, RATES, VELOCITIES
from casid.checks import checked
from casid.consistency.alignment import aligned
from casid.consistency.kinematics import kinematic_check
from casid.display import counted, listed
from casid.errors import DataWarning
from casid.excitations import excitation_if_any
from casid.files import write_csv
from casid.folder import at_once
from casid.logs.assembly import Lateness, assemble, delays, hold_doubt, hold_told, usual_dt
from casid.logs.axes import axes_outputs, axes_structure
from casid.logs.commands import still, undriven
from casid.logs.conventions import (
    check_units,
    derived,
    find_channels,
    others,
    with_units,
)
from casid.logs.reading import read_log
from casid.logs.sources import Source
from casid.logs.stretches import SHORTEST, Stretch, find_stretches, left_out, make_stretch
from casid.logs.topics import Log
from casid.logs.validation_split import unseen
from casid.logs.velocities import together, turned_anew
from casid.model import Model
from casid.outlier_detection import outliers
from casid.record import REST, Hold, Record
from casid.structure.modelfile import load_model, locate_model
from casid.textfile import write_text
from casid.threads import one_thread

FIRST = 0.6  # of a single stretch that identifies
TEMPLATE = """\
# Drafted from {log} ({kind}). Paths are relative to this file.
# Look first:  casid inspect study.toml        then:  casid identify study.toml

[study]
title = {title}
output = "out"
{notes}
[model]
file = {model}

# Channels are in SI and radians; inputs as the log has them.
{assumed}[channels]
hold = {hold} # between samples inputs are steps ("zoh") or straight lines ("foh")
{beside}{skew}

[pbsid]
transform = "laguerre" # a black box in continuous time, as the structure is

[records.identification] # stretches in which the inputs move; leave out those you doubt
files = {identification}
detrend = {trim} # "first": the mean before an input moves; "mean" where nothing is quiet

[records.validation] # serves in nothing else
files = {validation}
detrend = {own_trim}
"""


@dataclass(frozen=True, eq=False, kw_only=True)
class Draft:
    """What `import_log` made of a log.

    Parameters
    ----------
    log : Log
        All topics.
    inputs, outputs : mapping of str to Source
        Where the channels come from.
    records : tuple of Record
        The whole flight on one clock, total values in SI, one a stretch in which inputs were
        logged.
    stretches : tuple of Stretch
        Candidates for identification.
    delays : tuple of Lateness
        Between topics that hold the same quantity.
    moves : mapping of str to float
        Shifts [s] that bring outputs into line with kinematics. Shares from outside are those of
        records so moved; the records are as they were logged, and the study offers it.
    assumed : tuple of str
        What the log does not state and is taken for granted: units, and what inputs do between
        samples.
    doubts : tuple of str
        Why no aircraft may be in it, its outliers, and what was flown that stands in no stretch.
    study : Path
        The study file.
    """

    log: Log
    inputs: Mapping[str, Source]
    outputs: Mapping[str, Source]
    records: tuple[Record, ...]
    stretches: tuple[Stretch, ...]
    delays: tuple[Lateness, ...]
    moves: Mapping[str, float]
    assumed: tuple[str, ...]
    doubts: tuple[str, ...]
    study: Path


@checked
@one_thread
def import_log(
    path: str | Path,
    folder: str | Path | None = None,
    *,
    model: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    dt: float | None = None,
    hold: Hold | None = None,
    fresh: bool = False,
) -> Draft:
    """Turn a log into records, a structure and a study that runs.

    Parameters
    ----------
    path : path
        ULog, dataflash or TDMS; see `read_log`.
    folder : path
        Where they are written; the name of the log beside it unless given.
    model : str
        Structure, ``"models/multirotor.py:Multirotor"``; without it, one of the axes that move is
        written, each by itself.
    columns : mapping
        Columns of the log for channels, ``{"lat": "RCOU.C1"}``; those of PX4 and ArduPilot, and
        columns that bear a channel's name, are found.
    units : mapping
        Units of channels, ``{"p": "deg/s"}``, where the log states none or a wrong one.
    dt : float
        Sampling interval [s] of the records.
    hold : {"foh", "zoh"}
        What inputs did between their samples, lines through these or steps; as they look unless
        given.
    fresh : bool
        Replace a study that is there.

    Raises
    ------
    ValueError
        What `read_log` refuses; a study that is there already; no inputs or rates in the log, or
        too little of them; channels that the structure needs and the log lacks; outputs in units
        that are not known.
    """
    if dt is not None and not 0 < dt < np.inf:
        raise ValueError(f"dt={dt:g}: expected a sampling interval above 0 s, or none to choose it")
    log = derived(raw := read_log(path))
    folder = Path(folder) if folder is not None else log.path.with_suffix("")
    if (study := folder / "study.toml").exists() and not fresh:
        raise ValueError(
            f"{study} is there already and is left as it is; name another folder (--output), or "
            "replace it (--fresh)"
        )
    inputs, outputs = _channels(log, columns, dict(units or {}), model)
    assumed = check_units(log.path, {**inputs, **outputs}, outputs)
    dt = usual_dt(inputs, outputs, hold) if dt is None else dt
    assumed += hold_told(inputs, outputs, dt, hold)
    with _naming(log.path):
        outputs, records, cut, moves, told = _in_line(raw, inputs, outputs, dt, hold)
        assumed += told
        sound = [_sound(each.record) for each in cut]
        found = [_judged(*each, moves) for each in zip(cut, sound, strict=True)]
        late = delays([(taken, others(log, name, taken)) for name, taken in outputs.items()])
        _write(study, log, found, model, (assumed, hold_doubt(inputs, hold)), moves)
        doubts = _doubts(log, [each.record for each in found], sound, moves)
        doubts += left_out(records, found)
    return Draft(
        log=log,
        inputs=inputs,
        outputs=outputs,
        records=tuple(records),
        stretches=tuple(found),
        delays=tuple(late),
        moves=moves,
        assumed=tuple(assumed),
        doubts=doubts,
        study=study,
    )


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Errors of what is made of a log name it."""
    try:
        yield
    except ValueError as error:
        if str(path) in str(error):
            raise
        raise ValueError(f"{path}: {error}") from error


def _channels(
    log: Log, columns: Mapping[str, str] | None, stated: Mapping[str, str], model: str | None
) -> tuple[dict[str, Source], dict[str, Source]]:
    """Inputs and outputs of a structure, or of any, in the units stated."""
    structure = None if model is None else load_model(model)
    own = ((), ()) if structure is None else (structure.inputs, structure.outputs)
    inputs, outputs = find_channels(log, columns, own)
    inputs = {name: inputs[name] for name in own[0] or inputs if name in inputs}
    _check_found(log, inputs, outputs, structure)
    if strange := stated.keys() - inputs.keys() - outputs.keys():
        raise ValueError(
            f"{log.path}: a unit is stated for {min(strange)}, which is no channel of it"
        )
    return with_units(inputs, stated), with_units(outputs, stated)


def _stretches(log: Log, records: Sequence[Record], inputs: Collection[str]) -> list[Stretch]:
    """Two stretches or more; ValueError where inputs and outputs are too short together."""
    found = find_stretches(records)
    if len(found) < 2:
        found = _divided([each.record for each in found] or records)
    if not found:
        longest = max((record.duration for record in records), default=0.0)
        raise ValueError(
            f"{log.path}: inputs ({', '.join(inputs)}) and outputs were logged together for "
            f"{longest:.3g} s at most, {SHORTEST:g} s are wanted"
        )
    return found


def _in_line(
    log: Log, inputs: Mapping[str, Source], outputs: dict[str, Source], dt: float, hold: Hold | None
) -> tuple[dict[str, Source], list[Record], list[Stretch], dict[str, float], list[str]]:
    """Outputs, records, their stretches, what kinematics asks to move, and what was done for it.

    Velocities that an attitude turned which comes late are turned anew, if it is late then, too.
    """

    def flown(own: Mapping[str, Source]) -> tuple[list[Record], list[Stretch], dict[str, float]]:
        records = assemble(inputs, own, dt, log.path.stem.replace(" ", "_"), hold)
        cut = _stretches(log, records, inputs)
        moves = _moves([each.record for each in cut])
        return records, cut, moves if "TDMS" in log.kind else together(own, moves)

    records, cut, moves = flown(outputs)
    anew, late = turned_anew(log, outputs, moves)
    if anew:
        other = flown(outputs | anew)
        if {*ATTITUDES} & {*other[-1]}:
            how = f"{1000 * abs(late):.0f} ms {'later' if late > 0 else 'earlier'}"
            told = f"{listed([*anew])} are turned from north, east, down by attitudes logged {how}"
            return outputs | anew, *other, [f"{told}, as kinematics finds these late"]
    return outputs, records, cut, moves, []


def _moves(records: Sequence[Record]) -> dict[str, float]:
    """Shifts [s] that bring the study's records into line; none where kinematics tells nothing.

    They are those of ``shift = "kinematics"``.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # of gaps, which others tell
        try:
            return aligned(kinematic_check(records), records[0].outputs, (), records[0].inputs)[0]
        except (ValueError, IndexError):
            return {}


def _judged(stretch: Stretch, sound: Record, moves: Mapping[str, float]) -> Stretch:
    """The stretch with the excitation of its record so moved: late outputs look like feedback.

    Of the ``sound`` one, as outliers look like vibration.
    """
    if not moves and sound is stretch.record:
        return stretch
    return replace(stretch, excitation=excitation_if_any(sound.shift(moves)))


def _sound(record: Record) -> Record:
    """The record without its outliers; itself if it has none."""
    marks = outliers(record)
    return record.mask(marks) if marks.any() else record


def _check_found(
    log: Log,
    inputs: Mapping[str, Source],
    outputs: Mapping[str, Source],
    structure: type[Model] | None,
) -> None:
    """Refuse a log that lacks what the structure, or any, needs."""
    wanted = () if structure is None else (*structure.inputs, *structure.outputs)
    missing = [name for name in wanted if name not in inputs and name not in outputs]
    if not missing and not set(outputs) & set(RATES):
        missing = ["rates (p, q, r)"]
    if not missing and not inputs:
        raise ValueError(undriven(log, outputs))
    if missing:
        raise ValueError(
            f"{log.path}: no column is known for {missing[0]}; name it: --column "
            f"CHANNEL=TOPIC.COLUMN (columns={{...}}), of the topics {', '.join(log.topics)[:1000]}"
        )


def _doubts(
    log: Log, flown: Sequence[Record], sound: Sequence[Record], moves: Mapping[str, float]
) -> tuple[str, ...]:
    """What speaks against an aircraft in the stretches: actuators at rest, inputs fed back.

    And what is wild in them.
    """
    found = excitation_if_any([record.shift(moves) for record in sound])
    return (*still(log), *_wild(flown, sound), *(found.doubts() if found is not None else ()))


def _wild(flown: Sequence[Record], sound: Sequence[Record]) -> tuple[str, ...]:
    """What is said of outliers, which sound records lack."""
    lost = [np.isnan(rest.y) & ~np.isnan(own.y) for own, rest in zip(flown, sound, strict=True)]
    if not (count := sum(int(each.sum()) for each in lost)):
        return ()
    where = "; ".join(
        f"{record.name}: {', '.join(np.array(record.outputs)[marks.any(axis=0)])}"
        for record, marks in zip(flown, lost, strict=True)
        if marks.any()
    )
    return (
        f"{counted(count, 'sample')} far off all others ({where}): casid inspect says when; look, "
        'then leave them out (outliers = "mask" of [channels])',
    )


def _divided(records: Sequence[Record]) -> list[Stretch]:
    """The longest record in two, for identification and validation."""
    longest = max(records, key=lambda record: record.duration, default=None)
    if longest is None or longest.duration < SHORTEST:
        return []
    at = longest.t[0] + FIRST * longest.duration
    name = longest.name.split()[0].removesuffix("_1")
    parts = (longest.cut(longest.t[0], at), longest.cut(at, longest.t[-1]))
    return [make_stretch(part, f"{name}_{k}") for k, part in enumerate(parts, 1)]


def _beside(records: Sequence[Record], outputs: Collection[str]) -> list[str]:
    """What kinematics knows and records hold beside the outputs of a structure."""
    known = (*RATES, *FORCES, *ATTITUDES, *VELOCITIES, *AIR)
    names = [name for name in records[0].outputs if name in known and name not in outputs]
    return [n for n in names if all(np.isfinite(r.channel(n)).any() for r in records)]


def _write(
    study: Path,
    log: Log,
    found: Sequence[Stretch],
    model: str | None,
    said: tuple[Sequence[str], Sequence[str]],
    moves: Mapping[str, float],
) -> None:
    """Write records, structure and study; ``said``: what is assumed, and told with the results."""
    kept = unseen([each.moved for each in found])
    parts = [[found[k].record for k in range(len(found)) if (k in kept) == own] for own in (0, 1)]
    reference = "axes.py:Axes" if model is None else ":".join(map(str, locate_model(model)))
    own = axes_outputs(parts[0]) if model is None else load_model(reference, study.parent).outputs
    files = [json.dumps([f"data/{each.name}.csv" for each in part]) for part in parts]
    quiet = [all(each.quiet_samples() > REST / each.dt for each in part) for part in parts]
    trim = "first" if quiet[0] else "mean"
    beside = _beside([each.record for each in found], own)
    offered = {name: lag for name, lag in moves.items() if name in (*own, *beside)}
    lags = ", ".join(f"{name} = {lag:+.4f}" for name, lag in offered.items())
    stay = f"; inputs stay, so that their delays to {', '.join(offered)} change by as much"
    asked = f"# Kinematics asks for this{stay}. Without the first # of the line it is done:"
    words = {
        "skew": f"{asked}\n# shift = {{ {lags} }}"
        if offered
        else "# Kinematics asks for no shift.",
        "beside": f"check = {json.dumps(beside)} # in no estimate: kinematics judges by them\n"
        if beside
        else "",
        "log": log.path.name,
        "kind": log.kind,
        "assumed": "".join(f"# {each}\n" for each in said[0]),
        "notes": f"notes = {json.dumps(said[1])} # told with the results\n" if said[1] else "",
        "hold": json.dumps(found[0].record.hold),
        "title": json.dumps(log.path.stem),
        "model": json.dumps(reference),
        "identification": files[0],
        "validation": files[1],
        "trim": json.dumps(trim),
        "own_trim": json.dumps("identification" if quiet[0] and not quiet[1] else trim),
    }
    with at_once() as place:
        for record in (*parts[0], *parts[1]):
            write_csv(place(study.parent / "data" / f"{record.name}.csv"), record)
        if model is None:
            write_text(place(study.parent / "axes.py"), axes_structure(parts[0], log.path.name))
        write_text(place(study), TEMPLATE.format(**words))
