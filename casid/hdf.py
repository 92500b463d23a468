"""MATLAB files of version 7.3, which are HDF5; h5py is optional."""

import io
from pathlib import Path
from typing import Any

import numpy as np

from casid.checks import optional
from casid.folder import replacing
from casid.limits import TABLE_BYTES, check_size

SIGNATURE = b"\x89HDF\r\n\x1a\n"
OFFSETS = (0, 512, 1024, 2048)  # MATLAB writes a header of 512 bytes before it


def is_hdf(path: Path) -> bool:
    """Whether a file is HDF5 inside."""
    with path.open("rb") as file:
        head = file.read(OFFSETS[-1] + len(SIGNATURE))
    return any(head.startswith(SIGNATURE, offset) for offset in OFFSETS)


def read_hdf(path: Path) -> dict[str, Any]:
    """Numeric variables of a version 7.3 file by name; ValueError if damaged, large, no h5py."""
    h5py = optional("h5py", f"{path}: version 7.3")
    try:
        with h5py.File(path, "r") as file:
            found = {
                name: each
                for name, each in file.items()
                if isinstance(name, str)  # bytes, if they are no text
                and isinstance(each, h5py.Dataset)
                and each.dtype.kind in "fiub"
            }
            size = sum(8.0 * np.prod(each.shape, dtype=float) for each in found.values())
            check_size(path, size, TABLE_BYTES, "a MATLAB file")
            # MATLAB is column-major: HDF5 shows its arrays transposed.
            return {name: np.asarray(each[()]).T for name, each in found.items()}
    except Exception as error:  # damaged bytes raise anything in HDF5
        raise ValueError(
            f"{path}: cannot read it as a MATLAB file ({error}); save it again, as version 7"
        ) from error


def write_hdf(path: Path, variables: dict[str, Any]) -> None:
    """Write arrays so that MATLAB loads them as a version 7.3 file."""
    h5py = optional("h5py", f"{path}: version 7.3")
    buffer = io.BytesIO()  # a full disk would make HDF5 fail at every object once more
    with h5py.File(buffer, "w", userblock_size=512) as file:
        for name, values in variables.items():
            data = file.create_dataset(name, data=np.atleast_2d(values).T)
            data.attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, written by casid".ljust(116) + bytes(8) + b"\x00\x02IM"
    with replacing(path) as temporary, buffer.getbuffer() as contents, temporary.open("wb") as file:
        contents[: len(head)] = head
        file.write(contents)
