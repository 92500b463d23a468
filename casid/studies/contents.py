"""What a study hands to its report: results, digests of data and model, settings, versions."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from hashlib import sha256
from typing import Any

import numpy as np

from casid.channels import units_of
from casid.consistency.reused_flights import Repeats
from casid.jobs.digests import equations_digest
from casid.record import Record
from casid.report.content import Content, DataFile, Timing
from casid.stages.stage import Role, StageResults
from casid.structure.imports import structure_files
from casid.studies.preparation import Mending
from casid.studies.study import ChannelSettings, NextFlight, Study
from casid.studies.written import versions


def content(
    study: Study,
    records: Mapping[Role, Sequence[Record]],
    again: Repeats,
    found: StageResults,
    timings: Sequence[Timing],
    warnings: Sequence[str],
) -> Content:
    """All that the report of a study shows, with the digests of what it rests on."""
    return Content(
        title=study.title,
        model=study.model,
        results=found.results,
        models=found.models,
        model_files={
            os.path.relpath(file, study.path.parent.resolve()): sha256(held).hexdigest()
            for file, held in structure_files(study.model_file).items()
        },
        data=_data(study, records),
        settings=_settings(study),
        versions=versions(),
        timings=tuple(timings),
        warnings=tuple(dict.fromkeys(warnings)),
        repeats=again,
        units=_units(study),
        png=study.png,
    )


def _units(study: Study) -> dict[str, str]:
    """By channel: as stated, as the structure has it, as its name says."""
    own, stated = getattr(study.model, "units", {}), study.channels.units
    return units_of({}) | dict(own) | {k: u for k, u in units_of(stated).items() if k in stated}


def _data(study: Study, records: Mapping[Role, Sequence[Record]]) -> tuple[DataFile, ...]:
    return tuple(
        DataFile(
            role=role,
            name=record.name,
            path=os.path.relpath(file, study.path.parent),
            sha256=sha256(file.read_bytes()).hexdigest(),
            samples=record.N,
            seconds=record.duration,
            noise=study.roles[role].noise,
        )
        for role in records
        for record, file in zip(records[role], study.roles[role].files, strict=True)
    )


def _settings(study: Study) -> dict[str, str]:
    digest = sha256(study.path.read_bytes()).hexdigest()
    said: dict[str, str] = {"study file": f"{study.path.name}, SHA-256 {digest}"}
    said |= _written("model", study.model, type(study.model)())
    said["equations"] = f"as the structure builds them, SHA-256 {equations_digest(study.model)}"
    said |= _of_channels(study.channels)
    said |= _second_files(study)
    if study.noise is not None:
        std = ", ".join(f"{name} {value:g}" for name, value in study.noise.std.items())
        said["noise"] = f"seed {study.noise.seed}; standard deviations {std}"
    for role, each in study.roles.items():
        said[f"records.{role}"] = f"detrend {each.detrend}, {each.cutting.told()}"
        for flown, trim in each.trim.items():
            said[f"records.{role}.trim.{flown}"] = _shown(trim)
    if study.fixed:
        said["fixed"] = ", ".join(study.fixed)
    if study.bounds:
        said["bounds"] = ", ".join(f"{k} [{a:g}, {b:g}]" for k, (a, b) in study.bounds.items())
    for table, value in study.settings.items():
        usual = next(stage.settings for stage in study.stages if stage.table == table)
        said |= _written(table, value, usual) or {table: "as usual"}
    said |= _written("design", study.design, NextFlight())
    own = ", ".join(study.responses)
    return said | ({"output_error.responses": own} if own else {})


def _of_channels(channels: ChannelSettings) -> dict[str, str]:
    """How columns of files became channels."""
    plain = replace(channels, mending=Mending(), second=None, columns={})
    usual = ChannelSettings(inputs=channels.inputs, outputs=channels.outputs)
    said = _written("channels", plain, usual)
    if channels.columns:
        columns = ((name, _shown(column)) for name, column in channels.columns.items())
        said["channels.columns"] = "; ".join(f"{name}: {column}" for name, column in columns)
    said["channels.hold"] = channels.hold or "foh, as nothing else is stated"
    said |= channels.mending.told()
    return said | ({} if channels.second is None else {"channels.join": channels.second.told()})


def _second_files(study: Study) -> dict[str, str]:
    """Digests of the files that a second logger wrote beside those of the records."""
    if (second := study.channels.second) is None:
        return {}
    files = (second.beside(file) for each in study.roles.values() for file in each.files)
    digests = (
        f"{os.path.relpath(file, study.path.parent)} {sha256(file.read_bytes()).hexdigest()}"
        for file in dict.fromkeys(files)
    )
    return {"channels.join.files": f"SHA-256 {'; '.join(digests)}"}


def _written(place: str, value: Any, default: Any) -> dict[str, str]:  # noqa: ANN401 - any settings
    """Fields of settings that are not their defaults, as text."""
    said: dict[str, str] = {}
    for name in (each.name for each in fields(value)):
        own, usual = getattr(value, name), getattr(default, name)
        if is_dataclass(own):
            said |= _written(f"{place}.{name}", own, usual)
        elif _shown(own) != _shown(usual):
            said[f"{place}.{name}"] = _shown(own)
    return said


def _shown(value: object) -> str:
    if isinstance(value, np.ndarray) and value.ndim == 1 and len(value) > 6:
        return f"{len(value)} values, {value[0]:g} to {value[-1]:g}"
    if isinstance(value, np.ndarray):
        return np.array2string(value, precision=4, threshold=1000, separator=", ")
    if isinstance(value, Mapping) and not any(isinstance(x, Mapping) for x in value.values()):
        value = tuple(f"{name}: {x}" for name, x in value.items())
    return ", ".join(map(str, value)) if isinstance(value, tuple | list) else str(value)
