"""HDF5: a column a dataset, at the root or in the one group that has any.

Checked before anything is read: that a dataset lies in the file itself, the filters it is packed
by, and what its chunks unpack to, which HDF5 finds out only by unpacking.
"""

import math
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import h5py
from h5py import h5pl, h5z  # pyright: ignore[reportAttributeAccessIssue]

from srsinv.errors import refuse

from ...files import DataFile, is_broken, quoted
from .._apart import IsolatedReader
from .._stated import is_stated_word, is_word, plain_value, stated
from .._table import ColumnTable, listing

_Member = TypeVar("_Member", h5py.Dataset, h5py.Group)
_LZF = 32000
# Largest expansion of each of a chunk's bytes; 0: no more than it states.
_MOST_PER_BYTE: dict[int, int] = {h5z.FILTER_DEFLATE: 1032, _LZF: 88, h5z.FILTER_SZIP: 0}
_FILTERS = {*_MOST_PER_BYTE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32}
_UNPACKED = 2**28  # bytes that a chunk may unpack to, unchecked
_FEWEST_IN_CHUNK = 2**22  # values that a chunk may have more than its dataset
_CHECKSUM = 4  # bytes of fletcher32
_LARGEST_ATTRIBUTE = 2**20  # bytes
_PIECE = 2**20  # bytes that are unpacked at once
_MOST_MEMBERS = 10_000  # of all groups that are read


class Hdf5(IsolatedReader):
    """HDF5, at the root or in the one group that has datasets."""

    def read_here(self, file: DataFile) -> ColumnTable:
        """The datasets of the root or of the one group that has any, with their `units`."""
        table = ColumnTable.of(file)
        with open_hdf5(file) as opened:
            group = _group_of_columns(table, opened)
            leave_links_out(table, group)
            for holder in (opened, group):
                state_scalars(table, holder)
            for name, dataset in members(table, group, h5py.Dataset).items():
                take(table, name, dataset, vector(dataset.shape or ()))
            if group is opened:
                _leave_groups_out(table, opened)
        return table


@contextmanager
def open_hdf5(file: DataFile) -> Iterator[h5py.File]:
    """The file as HDF5, without the folders that HDF5 would load filters from."""
    folders = [h5pl.get(index) for index in range(h5pl.size())]
    try:
        while h5pl.size():
            h5pl.remove(0)
        with h5py.File(file, "r") as opened:
            yield opened
    finally:
        for folder in folders:
            h5pl.append(folder)


def take(
    table: ColumnTable, name: str, dataset: h5py.Dataset, shape: tuple[int, ...] | None
) -> None:
    """Take in a dataset as `shape`, unless there is a reason that it is no column."""
    facts = attributes(table, dataset)
    if reason := why_no_column(dataset):
        table.leave_out(name, reason, stated(facts).unit)
        return

    def read() -> Any:
        check_chunks(table, name, dataset)
        return dataset[...].ravel()

    table.take(name, shape or (), dataset.dtype, read, facts)


def why_no_column(dataset: h5py.Dataset) -> str | None:
    """Why a dataset is no column, whatever its shape, or None."""
    if dataset.is_virtual or dataset.external:
        return "lies in another file"
    try:
        dtype = dataset.dtype
    except TypeError:
        return "holds values of a type that NumPy does not have"
    if h5py.check_enum_dtype(dtype) is not None:
        return "holds values of an enumeration"
    codes = _filters(dataset)
    foreign = [code for code in codes if code not in _FILTERS]
    if foreign or sum(code in _MOST_PER_BYTE for code in codes) > 1:
        which = f"filter {foreign[0]}" if foreign else "more than one filter"
        return f"is packed by {which}, where one of gzip, lzf and szip is read"
    return None


def check_chunks(table: ColumnTable, name: str, dataset: h5py.Dataset) -> None:
    """Refuse chunks that hold, or unpack to, much more than their dataset."""
    if dataset.chunks is None:
        return
    values = math.prod(dataset.chunks)
    refuse(
        values > max(dataset.size or 0, _FEWEST_IN_CHUNK),
        f"{table.name}: column {quoted(name)} has {dataset.size} values in chunks of {values}: "
        "write it again with smaller chunks.",
    )
    packing = _filters(dataset)
    per_byte = max([0, *(_MOST_PER_BYTE.get(code, 0) for code in packing)])
    large: list[tuple[int, ...]] = []

    def note(chunk: Any) -> None:
        if chunk.size * per_byte > _UNPACKED:
            large.append(chunk.chunk_offset)

    if per_byte:
        dataset.id.chunk_iter(note)
    most = values * dataset.dtype.itemsize + _CHECKSUM
    for offset in large:
        skipped, packed = dataset.id.read_direct_chunk(offset)
        refuse(
            _unpacked(skipped, packed, packing, most) > most,
            f"{table.name}: column {quoted(name)} has chunks that may unpack to more than "
            f"their {most} bytes: write it again, in smaller chunks.",
        )


def _unpacked(skipped: int, packed: bytes, packing: list[int], most: int) -> int:
    """Bytes that a chunk unpacks to, counted as far as `most`; `skipped` has a bit for each filter
    that it was not packed by."""
    if _LZF in packing:
        return len(packed) * _MOST_PER_BYTE[_LZF]
    if skipped >> packing.index(h5z.FILTER_DEFLATE) & 1:
        return len(packed)
    inflater, count = zlib.decompressobj(), 0
    while packed and count <= most and not inflater.eof:
        count += len(inflater.decompress(packed, _PIECE))
        packed = inflater.unconsumed_tail
    return count


def attribute(table: ColumnTable, holder: h5py.Dataset | h5py.Group, name: str) -> Any:
    """A small attribute of a dataset or a file, or None. Raises `BadInput` for a large one."""
    if name not in holder.attrs:
        return None
    stored = holder.attrs.get_id(name).get_storage_size()
    refuse(
        stored > _LARGEST_ATTRIBUTE,
        f"{table.name}: attribute {name} takes {stored} bytes, above the limit of "
        f"{_LARGEST_ATTRIBUTE}: write it shorter.",
    )
    return holder.attrs[name]


def attributes(table: ColumnTable, holder: h5py.Dataset | h5py.Group) -> dict[str, Any]:
    """The attributes that state anything of a column: its unit, scale, offset, gain and times."""
    table.check_count(len(holder.attrs))
    return {key: attribute(table, holder, key) for key in holder.attrs if is_word(key)}


def state_scalars(table: ColumnTable, holder: h5py.Group) -> None:
    """Add what a group states of all columns."""
    found = attributes(table, holder)
    table.scalars.update(
        {
            key: plain_value(value)
            for key, value in found.items()
            if is_stated_word(key, may_be_ambiguous=False)
        }
    )


def members(table: ColumnTable, group: h5py.Group, kind: type[_Member]) -> dict[str, _Member]:
    """The members of `kind` in the file itself: a link may lead to another file, or nowhere."""
    table.check_count(len(group))
    for name in filter(is_broken, _names(group)):
        table.check_name(name)  # which refuses it
    own = {name: group[name] for name in _names(group) if not _is_link(group, name)}
    found = {name: member for name, member in own.items() if isinstance(member, kind)}
    return dict(sorted(found.items(), key=lambda each: _in_order(each[0])))


def vector(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape of a column that is stored as (n, 1) or (1, n), as MATLAB does, or as it is."""
    return (max(shape),) if len(shape) == 2 and min(shape) == 1 else tuple(shape)


def _in_order(name: str) -> tuple[Any, ...]:
    """What names are sorted by, so that ch2 comes before ch10: HDF5 sorts them as text."""
    parts = re.split(r"(\d+)", name)
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in parts)


def _leave_groups_out(table: ColumnTable, file: h5py.File) -> None:
    """Record the datasets of groups beside columns at the root, which are not read."""
    for name, group in members(table, file, h5py.Group).items():
        for inner, dataset in members(table, group, h5py.Dataset).items():
            unit = stated(attributes(table, dataset)).unit
            table.leave_out(f"{name}/{inner}", "lies in a group beside columns at the root", unit)


def leave_links_out(table: ColumnTable, group: h5py.Group) -> None:
    """Links are not followed; one that is asked for is refused by its name."""
    for name in _names(group):
        if _is_link(group, name):
            table.leave_out(name, "is a link, which may lead to another file")


def _names(group: h5py.Group) -> list[str]:
    """The names in a group, with halves of characters for bytes that are no text."""
    return [
        name.decode("utf-8", "surrogateescape") if isinstance(name, bytes) else str(name)
        for name in group
    ]


def _is_link(group: h5py.Group, name: str) -> bool:
    return not isinstance(group.get(name, getlink=True), h5py.HardLink)


def _filters(dataset: h5py.Dataset) -> list[int]:
    """The codes of the filters that a dataset's chunks are packed by, in their order."""
    pipeline = dataset.id.get_create_plist()
    return [int(pipeline.get_filter(index)[0]) for index in range(pipeline.get_nfilters())]


def _group_of_columns(table: ColumnTable, file: h5py.File) -> h5py.Group:
    """The root if it has columns, else the one group that has."""
    if members(table, file, h5py.Dataset):
        return file
    groups = members(table, file, h5py.Group)
    refuse(
        sum(map(len, groups.values())) > _MOST_MEMBERS,
        f"{table.name}: the groups hold more than {_MOST_MEMBERS} datasets: keep one recording in "
        "one file.",
    )
    filled = [name for name, group in groups.items() if _has_dataset(group)]
    refuse(
        len(filled) > 1,
        f"{table.name}: there are columns in several groups, {listing(filled)}: keep one recording "
        "in one file.",
    )
    links = listing(name for name in _names(file) if _is_link(file, name))
    refuse(
        not filled,
        f"{table.name}: there is no column at the root or in a group of it, and links ({links}) "
        "are not followed: keep one recording in one file, without links.",
    )
    return groups[filled[0]]


def _has_dataset(group: h5py.Group) -> bool:
    """Whether any member in the file itself is a dataset."""
    return any(
        not _is_link(group, name) and isinstance(group[name], h5py.Dataset)
        for name in _names(group)
        if not is_broken(name)
    )
