"""What a MATLAB file of version 5 to 7 holds, looked at before SciPy reads it.

SciPy takes the type of an array's data from the file as an index without a check, so a damaged one
ends the process. Format: MAT-File Format, The MathWorks, chapter 1.
"""

import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

MATRIX, COMPRESSED = 14, 15  # types of elements of the file
CLASSES = range(6, 16)  # of arrays of numbers: double, single, (u)int8 to (u)int64
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})  # types of their data
COMPLEX = 0x800
HEADER = 128
HEAD = 4096  # bytes of an element that tell its class, name and type of data
PACKED = 65536  # bytes of a compressed element that hold its head


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
