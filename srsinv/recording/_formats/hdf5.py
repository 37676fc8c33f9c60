"""HDF5: a column a dataset, at the root or in the one group that has any."""

from pathlib import Path
from typing import TypeVar

import h5py

from srsinv.errors import refuse

from .._table import Table, listing

_Member = TypeVar("_Member")


def read_hdf5(path: Path) -> Table:
    """The datasets of the root or of the one group that has any, with their `units`."""
    table = Table(path.name)
    with h5py.File(path, "r") as file:
        for name, dataset in members(_group_of_columns(path.name, file), h5py.Dataset).items():
            take(table, name, dataset, dataset.shape)
    return table


def take(table: Table, name: str, dataset: h5py.Dataset, shape: tuple[int, ...] | None) -> None:
    """Take in a dataset as `shape`, unless its values lie in another file."""
    if dataset.is_virtual or dataset.external:
        table.unusable[name] = "lies in another file"
    else:
        units = dataset.attrs.get("units")
        table.take(name, shape or (), dataset.dtype, lambda: dataset[...].ravel(), units)


def members(group: h5py.Group, kind: type[_Member]) -> dict[str, _Member]:
    """The members of `kind` in the file itself: a link may lead to another file, or nowhere."""
    links = {str(name): group.get(name, getlink=True) for name in group}
    own = {name: group[name] for name, link in links.items() if isinstance(link, h5py.HardLink)}
    return {name: member for name, member in own.items() if isinstance(member, kind)}


def _group_of_columns(name: str, file: h5py.File) -> h5py.Group:
    """The root if it has columns, else the one group that has."""
    if members(file, h5py.Dataset):
        return file
    groups = members(file, h5py.Group)
    filled = [group for group in groups if members(groups[group], h5py.Dataset)]
    refuse(
        len(filled) != 1,
        f"{name}: columns are looked for at the root or in one group, but the groups that hold any "
        f"are {listing(filled)}: keep one recording in one file.",
    )
    return groups[filled[0]]
