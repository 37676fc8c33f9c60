"""From a `Recording` to a file that `load` gives back bit by bit."""

import csv
import glob
import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import xarray as xr

from srsinv.errors import BadInput, refuse
from srsinv.scratch import abandoned

from ._recording import POSITION, SPEED, TIME, Recording


def save(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write `recording` to NAME.csv with NAME.json beside it, or to NAME.nc, which holds both.

    A missing sample is an empty cell, or NaN. A signal in mV is written as such, and `load` gives
    it in V. Each file appears whole or not at all. Raises `BadInput` for another suffix, a sidecar
    that JSON cannot hold, and a place that cannot be written to.
    """
    path = Path(path).expanduser()
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise BadInput(
            f"{path.name}: a recording cannot be written as {path.suffix!r}: use one of "
            f"{', '.join(_WRITERS)}."
        )
    sidecar = _sidecar_text(recording, path)
    try:
        writer(recording, path, sidecar)
    except OSError as error:
        raise BadInput(
            f"{path}: the file cannot be written ({error.strerror or 'write error'}): give a path "
            "in a folder that is there and can be written to."
        ) from error


def _sidecar_text(recording: Recording, path: Path) -> str:
    layout = {"channels": list(recording.channels), "signal_unit": recording.signal_unit}
    try:
        return json.dumps({**recording.sidecar, **layout}, indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise BadInput(
            f"{path.name}: the sidecar cannot be written as JSON ({error}): keep to text, finite "
            "numbers, lists and mappings."
        ) from error


def _save_csv(recording: Recording, path: Path, sidecar: str) -> None:
    with _whole(path.with_suffix(".json")) as scratch:
        scratch.write_text(sidecar + "\n", encoding="utf-8")
    motion = {column: values for column, (values, _) in _motion(recording).items()}
    columns = np.vstack([*motion.values(), recording.signal])
    with _whole(path) as scratch, scratch.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*motion, *recording.channels])
        for row in columns.T.tolist():
            writer.writerow(["" if math.isnan(value) else repr(value) for value in row])


def _save_netcdf(recording: Recording, path: Path, sidecar: str) -> None:
    slashed = next((channel for channel in recording.channels if "/" in channel), None)
    refuse(
        slashed is not None,
        f"{path.name}: netCDF cannot name a variable {slashed!r}: rename the channel without '/', "
        "or save it as .csv.",
    )
    columns = {
        column: ("sample", values, {"units": unit})
        for column, (values, unit) in _motion(recording).items()
    }
    for channel, signal in zip(recording.channels, recording.signal, strict=True):
        columns[channel] = ("sample", signal, {"units": recording.signal_unit})
    with _whole(path) as scratch:
        xr.Dataset(columns, attrs={"sidecar": sidecar}).to_netcdf(scratch, engine="h5netcdf")


def _motion(recording: Recording) -> dict[str, tuple[np.ndarray, str]]:
    """The columns beside the signals, with their units."""
    columns = {TIME: (recording.time_s, "s"), SPEED: (recording.speed_m_per_s, "m/s")}
    if recording.measured_position_m is not None:
        columns[POSITION] = (recording.measured_position_m, "m")
    return columns


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """A scratch file in the folder of `path` that takes its place once it is written."""
    scratch = path.with_name(f".{path.name}.{os.getpid()}")
    for left_over in path.parent.glob(f".{glob.escape(path.name)}.*"):
        if abandoned(left_over.suffix[1:]):
            with suppress(OSError):  # another user's
                left_over.unlink(missing_ok=True)
    try:
        yield scratch
        os.replace(scratch, path)
    finally:
        scratch.unlink(missing_ok=True)


_WRITERS = {".csv": _save_csv, ".nc": _save_netcdf}
