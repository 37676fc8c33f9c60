"""MATLAB's version 5 files ("MAT-File Level 5" in MathWorks' description of the format).

Read here rather than by scipy, whose reader can take the whole process down on a damaged file, and
builds structs and objects that are not needed. Only the vectors' own bytes are read.
"""

import math
import struct
import zlib

import numpy as np

from ...files import DataFile
from .._table import MOST_COLUMNS, ColumnTable
from .hdf5 import vector

_HEADER = 128  # bytes, the last two of which give the byte order
_ORDERS = {b"IM": "<", b"MI": ">"}
_MATRIX, _COMPRESSED = 14, 15
_STORED = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_CLASSES = {
    1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 6: "double", 7: "single",
    8: "int8", 9: "uint8", 10: "int16", 11: "uint16", 12: "int32", 13: "uint32", 14: "int64",
    15: "uint64", 16: "function", 17: "opaque object",
}  # fmt: skip
NUMERIC = {name for number, name in _CLASSES.items() if 6 <= number <= 15}
_COMPLEX, _LOGICAL = 0x800, 0x200
_LONGEST = 4096  # bytes of a name or of dimensions
_PIECE = 2**16  # compressed bytes that are read at once


class _Part:
    """The next bytes of a file, `size` of them and no more."""

    def __init__(self, file: DataFile, size: int):
        self._file, self._left = file, size

    def read(self, size: int, /) -> bytes:
        part = self._file.read(min(size, self._left))
        self._left -= len(part)
        return part


class _Inflated:
    """Compressed bytes, inflated only as far as they are asked for."""

    def __init__(self, packed: _Part):
        self._inflater, self._packed = zlib.decompressobj(), packed

    def read(self, size: int, /) -> bytearray:
        data = bytearray()
        while len(data) < size and not self._inflater.eof:
            packed = self._inflater.unconsumed_tail or self._packed.read(_PIECE)
            part = self._inflater.decompress(packed, size - len(data))
            if not packed and not part:
                break
            data += part
        return data


class _Within:
    """The next bytes of a stream, `size` of them and no more."""

    def __init__(self, stream: "_Stream", size: int):
        self._stream, self._left = stream, size

    def read(self, size: int, /) -> bytes | bytearray:
        part = self._stream.read(min(size, self._left))
        self._left -= len(part)
        return part

    def pass_over(self) -> None:
        """Read what is left."""
        while self._left and self.read(_PIECE):
            pass


_Stream = _Part | _Inflated | _Within
_Bytes = bytes | bytearray


def read_matlab5(file: DataFile) -> ColumnTable:
    """The vectors of numbers in the file, those of a struct's fields included."""
    table = ColumnTable.of(file)
    order = _ORDERS[file.read(_HEADER)[_HEADER - 2 :]]
    end, count = _HEADER, 0
    while end < file.size:
        file.seek(end)
        kind, size = struct.unpack(f"{order}II", file.read(8))
        end += 8 + size
        count += 1
        table.check_count(count)
        if end > file.size:
            raise EOFError("cut short")
        stream: _Stream = _Part(file, size)
        if kind == _COMPRESSED:
            stream = _Inflated(stream)
            kind, _ = struct.unpack(f"{order}II", _exactly(stream, 8))
        if kind != _MATRIX:
            raise ValueError("not a variable")
        _take(table, stream, order)
    return table


def _take_struct(table: ColumnTable, name: str, stream: _Stream, order: str) -> None:
    """Take in the fields of a struct, as `struct.field`."""
    longest = int(np.frombuffer(_element(stream, order)[1], f"{order}i4")[0])
    names = bytes(_element(stream, order, MOST_COLUMNS * _LONGEST)[1])
    if not 0 < longest <= _LONGEST:
        raise ValueError("names longer than they can be")
    fields = [names[at : at + longest].rstrip(b"\0") for at in range(0, len(names), longest)]
    table.check_count(len(fields))
    for field in fields:
        kind, size = struct.unpack(f"{order}II", _exactly(stream, 8))
        if kind != _MATRIX:
            raise ValueError("not a variable")
        part = _Within(stream, size)
        _take(table, part, order, f"{name}.{field.decode('ascii')}")
        part.pass_over()


def _take(table: ColumnTable, stream: _Stream, order: str, inside: str = "") -> None:
    """Take in a variable, or a field of a struct under the name `inside`."""
    flags = int(np.frombuffer(_element(stream, order)[1], f"{order}u4")[0])
    name_of_class = _CLASSES[flags & 0xFF]
    # An opaque object has no dimensions before its name.
    opaque = name_of_class == _CLASSES[17]
    shape = () if opaque else np.frombuffer(_element(stream, order)[1], f"{order}i4").tolist()
    name = _element(stream, order)[1].decode("ascii") or inside
    if not name:  # what belongs to functions and objects
        return
    if name_of_class == "struct" and not inside and math.prod(shape) == 1:
        _take_struct(table, name, stream, order)
    elif name_of_class not in NUMERIC:
        table.leave_out(name, f"is a MATLAB {name_of_class}")
    elif flags & (_COMPLEX | _LOGICAL):
        table.leave_out(name, f"holds {'complex' if flags & _COMPLEX else 'logical'} values")
    else:

        def read() -> np.ndarray:
            kind, data = _element(stream, order, 8 * math.prod(shape))
            values = np.frombuffer(data, f"{order}{_STORED[kind]}")
            if values.size != math.prod(shape):
                raise EOFError("not as many values as stated")
            return values

        table.take(name, vector(tuple(shape)), np.dtype(np.float64), read)


def _element(stream: _Stream, order: str, longest: int = _LONGEST) -> tuple[int, _Bytes]:
    """The next part of a variable: its type and its bytes, of which a few stand in its tag."""
    (kind,) = struct.unpack(f"{order}I", _exactly(stream, 4))
    if kind >> 16:
        return kind & 0xFFFF, _exactly(stream, 4)[: kind >> 16]
    (size,) = struct.unpack(f"{order}I", _exactly(stream, 4))
    if size > longest:
        raise ValueError("longer than it can be")
    data = _exactly(stream, size)
    stream.read(-size % 8)
    return kind, data


def _exactly(stream: _Stream, size: int) -> _Bytes:
    data = stream.read(size)
    if len(data) < size:
        raise EOFError("cut short")
    return data
