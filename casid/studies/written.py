"""What a study wrote, taken as it lies if nothing has changed that it was made of."""

import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

from casid.folder import PARTIAL
from casid.jobs.digests import equations_digest, own_source, source_digest, structure_digest
from casid.jobs.store import Done, Store
from casid.limits import TABLE_BYTES, TEXT_BYTES, check_file
from casid.report.content import Timing
from casid.report.verdicts import Verdict
from casid.studies.study import Study
from casid.values import digest

NAME = "written"  # of its file in the folder of results
PACKAGES = ("casid", "casadi", "numpy", "scipy", "matplotlib")  # whose versions the page names
WRITTEN = (
    "report.html",
    "fit.json",
    "parameters.csv",
    "bounds.csv",
    "bounds_cases.csv",
    "bounds.md",
)
APART = ("output", "model", "stages")  # fields of a study that stand in the key otherwise, or not


@dataclass(frozen=True, eq=False, kw_only=True)
class Written:
    """Digests of the files a study wrote, by name, and what it had to say."""

    files: Mapping[str, str]
    made: tuple[str, ...] = ()  # of them, what is no stage's result but page, table or figure
    timings: tuple[Timing, ...]
    verdicts: tuple[Verdict, ...] = ()
    cautions: tuple[str, ...] = ()
    headlines: Mapping[str, bool | None]  # and whether it is good news
    seen: tuple[str, ...] = ()  # validation records that an estimation has seen
    warnings: tuple[str, ...] = ()  # of the records


def versions() -> dict[str, str]:
    """Versions of Python and of what computes and draws."""
    return {"Python": platform.python_version()} | {name: version(name) for name in PACKAGES}


def read_written(study: Study) -> Written | None:
    """What an earlier run left, if all of it is there and made of the same; else None."""
    store = _store(study)
    if not store.path(NAME).exists():
        return None
    done = store.get(NAME, origin(study))
    found: Written | None = None if done is None else done.result
    return found if found is not None and found.files == digests(study) else None


def told_of_fit(study: Study) -> Written | None:
    """What was said as the fit was written that lies there, whatever has changed of it since."""
    last, file = _store(study).get(NAME, None), study.output / "fit.json"
    found: Written | None = None if last is None else last.result
    if found is None or not file.exists() or found.files.get(file.name) != _digest(file):
        return None
    return found


def keep_written(study: Study, origin: str, written: Written) -> None:
    """Note what a study wrote, and the `origin` it had before it read its records."""
    _store(study).put(NAME, origin, Done(result=written))


def made(study: Study) -> dict[str, tuple[int, int]]:
    """Pages, tables and figures in the folder of results, by name; a new file has other numbers."""
    files = [study.output / name for name in WRITTEN]
    files += sorted((study.output / "figures").glob("*"))
    states = {file: file.stat() for file in files if file.is_file()}
    return {
        file.relative_to(study.output).as_posix(): (state.st_ino, state.st_mtime_ns)
        for file, state in states.items()
    }


def delete_earlier(study: Study, before: Mapping[str, tuple[int, int]]) -> tuple[str, ...]:
    """Delete what an earlier run made and this one did not; the names of what this one made.

    ``before`` is what `made` returned when this run began. Files of others stay.
    """
    now = made(study)
    own = tuple(name for name, state in now.items() if before.get(name) != state)
    last = _store(study).get(NAME, None)
    for name in set() if last is None else {*last.result.made} & {*now} - {*own}:
        (study.output / name).unlink(missing_ok=True)
    return own


def digests(study: Study) -> dict[str, str]:
    """Digests (SHA-256) of all files of the study in its folder of results."""
    folders = ["figures", "stages", *(stage.name for stage in study.stages if stage.command)]
    files = [study.output / name for name in WRITTEN]
    files += [file for folder in folders for file in sorted((study.output / folder).glob("*"))]
    return {
        file.relative_to(study.output).as_posix(): _digest(file)
        for file in files
        if file.is_file() and file.suffix != PARTIAL
    }


def _digest(file: Path) -> str:
    return sha256(file.read_bytes()).hexdigest()


def _from_its_folder(study: Study) -> Study:
    """The same with its paths as seen from its folder, wherever that lies and however it is named.

    The working folder is no part of what a study says.
    """
    folder = study.path.parent.resolve()

    def seen(files: Iterable[Path]) -> tuple[Path, ...]:
        places = (file.parent.resolve() / file.name for file in files)
        return tuple(Path(os.path.relpath(place, folder)) for place in places)

    roles = {
        role: replace(each, files=seen(each.files), patterns=seen(each.patterns))
        for role, each in study.roles.items()
    }
    path, model_file = seen([study.path, study.model_file])
    return replace(study, roles=roles, path=path, model_file=model_file)


def _store(study: Study) -> Store:
    return Store(study.output, (Written, Timing, Verdict))


def origin(study: Study) -> str:
    """Digest of all that the files of a study are made of: records as their files have them.

    ValueError: one of them is gone, or no file.
    """
    from_its_folder = _from_its_folder(study)
    said = [getattr(from_its_folder, each.name) for each in fields(study) if each.name not in APART]
    flown = [file for each in study.roles.values() for file in each.files]
    second = study.channels.second
    flown += [] if second is None else [second.beside(file) for file in flown]
    check_file(study.path, TEXT_BYTES, "a study file")  # since it was read
    check_file(study.model_file, TEXT_BYTES, "a model file")
    for file in flown:
        check_file(file, TABLE_BYTES, "a record")
    return digest(
        [source_digest(shown=True), versions()],
        [structure_digest(study.model_file), equations_digest(study.model), asdict(study.model)],
        [(stage.name, own_source(stage.run)) for stage in study.stages],
        said,
        [_digest(file) for file in (study.path, *dict.fromkeys(flown))],
    )
