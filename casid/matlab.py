"""Variables of MATLAB files: versions 4 to 7 by SciPy, 7.3 (HDF5) by h5py, which is optional.

SciPy takes the type of an array's data from the file as an index without a check, so a damaged one
ends the process: files of version 5 to 7 are looked at before (MAT-File Format, The MathWorks,
chapter 1).
"""

import io
import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from casid.checks import optional
from casid.folder import replacing
from casid.limits import TABLE_BYTES, check_file, check_size

MATRIX, COMPRESSED = 14, 15  # types of elements of the file
CLASSES = range(6, 16)  # of arrays of numbers: double, single, (u)int8 to (u)int64
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})  # types of their data
COMPLEX = 0x800
HEADER = 128
HEAD = 4096  # bytes of an element that tell its class, name and type of data
PACKED = 65536  # bytes of a compressed element that hold its head
SIGNATURE = b"\x89HDF\r\n\x1a\n"
OFFSETS = (0, 512, 1024, 2048)  # MATLAB writes a header of 512 bytes before it


def read_variables(path: str | Path) -> dict[str, Any]:
    """Variables of a MATLAB file by name (7.3 needs h5py); ValueError if damaged or too large."""
    path = Path(path)
    check_file(path, TABLE_BYTES, "a MATLAB file")
    if is_hdf(path):
        return read_hdf(path)
    try:
        sizes = [8.0 * np.prod(shape, dtype=float) for _, shape, _ in scipy.io.whosmat(str(path))]
        check_size(path, sum(sizes), TABLE_BYTES, "a MATLAB file")
        if scipy.io.matlab.matfile_version(str(path))[0] == 0:  # version 4
            return dict(scipy.io.loadmat(str(path), appendmat=False))
        held = numeric_variables(path)
        wanted = [name for name, numeric in held.items() if numeric]
        read = scipy.io.loadmat(str(path), appendmat=False, variable_names=wanted)
        return {name: read.get(name, np.array(None)) for name in held}
    except Exception as error:  # damaged bytes raise anything in SciPy
        raise ValueError(
            f"{path}: cannot read it as a MATLAB file ({error}); save it again, as version 7"
        ) from error


def numeric_variables(path: Path) -> dict[str, bool]:
    """Names of all variables, and whether each is a real array; ValueError for a damaged file."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        order = ">" if data[126:128] == b"MI" else "<"
        try:
            return dict(_variable(head, order) for head in _heads(data, order))
        except (struct.error, zlib.error, UnicodeDecodeError) as error:
            raise ValueError(f"a variable's header is damaged: {error}") from error


def _heads(data: mmap.mmap, order: str) -> Iterator[bytes]:
    position = HEADER
    while position + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        begin, position = position + 8, position + 8 + size
        head = data[begin : min(begin + PACKED, position)]
        if kind == COMPRESSED:
            head = zlib.decompressobj().decompress(head, HEAD)
            kind, head = struct.unpack_from(f"{order}I", head)[0], head[8:]
        if kind != MATRIX:
            raise ValueError(f"an element of type {kind} stands where a variable is expected")
        yield head[:HEAD]


def _variable(head: bytes, order: str) -> tuple[str, bool]:
    (flags,) = struct.unpack_from(f"{order}I", head, 8)
    _, _, after_shape = _tag(head, 16, order)
    _, text, after_name = _tag(head, after_shape, order)
    name = text.decode("latin-1")
    if flags & 0xFF not in CLASSES or flags & COMPLEX:
        return name, False
    kind, _, _ = _tag(head, after_name, order)
    if kind not in NUMBERS:
        raise ValueError(f"variable {name!r} has data of type {kind}, which is none of numbers")
    return name, True


def _tag(head: bytes, position: int, order: str) -> tuple[int, bytes, int]:
    """Type and bytes of an element within a variable, and where the next begins."""
    kind, size = struct.unpack_from(f"{order}II", head, position)
    if kind >> 16:  # up to four bytes stand in the tag itself
        return kind & 0xFFFF, head[position + 4 : position + 4 + (kind >> 16)], position + 8
    begin = position + 8
    return kind, head[begin : begin + size], begin + size + -size % 8


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
