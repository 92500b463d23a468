"""Measured responses that count in a study's refinement beside its time histories."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from casid.display import listed
from casid.errors import DataWarning
from casid.exchange.formats import read_table
from casid.frequency.estimation import SpectralAnalysis
from casid.frequency.response import FrequencyResponse
from casid.frequency.responses import read_frequency_csv
from casid.model import Model
from casid.shooting.measured_responses import check_responses
from casid.stages.refinement import OUTPUT_ERROR
from casid.stages.stage import Role, Task, records_of
from casid.tables import Table, placed

MEASURED: Role = "frequency"  # the response of the records of that role
KINDS = ("dB", "deg", "coherence", "error")  # columns of a pair in a table of casid's


def read_responses(names: Sequence[str], folder: Path, model: Model) -> list[FrequencyResponse]:
    """Responses of files, relative to a folder; ``MEASURED`` is none.

    ValueError: a file that is not there or holds no response of the structure's channels.
    """
    with placed("[output_error]"):
        return [_read(folder / name, model) for name in names if name != MEASURED]


def _read(file: Path, model: Model) -> FrequencyResponse:
    """The response of a file: saved, kept by a study, or a table with the names of casid's."""
    if file.suffix.lower() not in (".json", ".csv") or not file.is_file():
        raise ValueError(
            f'responses: there is no file {file}; expected "{MEASURED}" (the response of '
            "[records.frequency]) and names of .json or .csv files"
        )
    if file.suffix.lower() == ".csv":
        return _table(file, model)
    return FrequencyResponse.load(file)


def _table(file: Path, model: Model) -> FrequencyResponse:
    """The response of a CSV file, pairs by the names of its columns."""
    columns = read_table(file)
    every = {
        (output, name): [f"{output}_{name}_{kind}" for kind in KINDS]
        for output in model.outputs
        for name in model.inputs
    }
    pairs = {pair: own for pair, own in every.items() if {*own} <= {*columns}}
    if not pairs or "omega" not in columns:
        needed = [("omega", *own) for own in every.values()]
        _, lacks = min(
            (len({*own} - {*columns}), [n for n in own if n not in columns]) for own in needed
        )
        raise ValueError(
            f"responses: {file} has no column {', '.join(lacks)} (omega is in rad/s), nor all of "
            f"another pair; it has {listed([*columns])}: name its columns so, or read it with "
            "read_frequency_csv and save() it as JSON"
        )
    return read_frequency_csv(file, pairs=pairs)


def response_names(
    table: Table, files: Mapping[Role, Sequence[Path]], choice: bool
) -> tuple[str, ...]:
    """The key ``responses``; ValueError for a measured response without records of its own."""
    names = table.names("responses")
    if MEASURED not in names:
        return names
    if not files.get(MEASURED):
        raise ValueError(
            f'{table.place} responses: "{MEASURED}" needs records: write [records.{MEASURED}]'
        )
    role: Role = "refinement" if files.get("refinement") else "identification"
    own = {file.resolve() for file in files[role]}
    for file in files[MEASURED]:
        if file.resolve() in own:
            raise ValueError(
                f"{table.place} responses: record {file.stem!r} would count twice, as a time "
                f"history of [records.{role}] and in the response of [records.{MEASURED}]; write "
                "[records.refinement] with the files of the others"
            )
    if choice:
        raise ValueError(
            f'{table.place} responses = "{MEASURED}" does not go with [choice], whose candidate '
            '"joint" is just that; leave one of them out'
        )
    return names


def with_measured(task: Task, names: Sequence[str]) -> Task:
    """The task, its refinement taking the response of the records of role frequency, if named.

    ValueError: a flight that counts twice, a structure that takes no responses.
    """
    if not names:
        return task
    own = task.settings[OUTPUT_ERROR.table]
    if MEASURED in names:
        analysis = task.settings.get("frequency", SpectralAnalysis())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)  # the stage tells them
            found = analysis.fit(task.roles[MEASURED])
        own = replace(own, responses=(*own.responses, found))
    with placed(f"[{OUTPUT_ERROR.table}]"):
        check_responses(task.model, own.responses, records_of(OUTPUT_ERROR, task.roles))
    settings: dict[str, Any] = {**task.settings, OUTPUT_ERROR.table: own}
    return replace(task, settings=settings)
