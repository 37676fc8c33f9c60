"""Writing of a `Recording` to a file that `load` restores bit by bit."""

import csv
import io
import json
import math
import os
from pathlib import Path

import numpy as np

from srsinv.atomic import write_whole, writing
from srsinv.errors import BadInput, refuse
from srsinv.files import LARGEST_FILE, read_bytes

from ._recording import POSITION, SPEED, TIME, Recording
from ._sidecar import SUFFIXES
from .formats import BY_SUFFIX
from .reader import read_table


def save(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write `recording` to NAME.csv with NAME.json beside it, or to NAME.nc, which holds both.

    A missing sample is an empty cell, or NaN. A signal in mV is written as such, and `load` gives
    it in V. Each file appears whole or not at all, the sidecar first. An earlier recording in
    NAME.nc is replaced; NAME.csv only where NAME.json is identical, as another sidecar may be a
    user's work and would be read with the wrong data if this ended half-way. Raises `BadInput` for
    that, prepared signals (preparation.py), another suffix, a sidecar that JSON cannot hold, and a
    place that cannot be written to.
    """
    path = Path(path).expanduser()
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise BadInput(
            f"{path.name}: a recording cannot be written as {path.suffix!r}: use one of "
            f"{', '.join(_WRITERS)}."
        )
    refuse(
        recording.raw_signal is not None,
        f"{path.name}: the signals of {recording.name} are filtered already, and "
        "reading would filter them again: save the recording as it was loaded.",
    )
    layout = {"channels": list(recording.channels), "signal_unit": recording.signal_unit}
    try:
        sidecar = json.dumps({**recording.sidecar, **layout}, indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise BadInput(
            f"{path.name}: the sidecar cannot be written as JSON ({error}): keep to text, finite "
            "numbers, lists and mappings."
        ) from error
    with writing(path):
        writer(recording, path, sidecar)


def _save_csv(recording: Recording, path: Path, sidecar: str) -> None:
    beside, facts = path.with_suffix(".json"), f"{sidecar}\n".encode()
    is_new = _check_sidecars(path, facts)
    motion = {column: values for column, (values, _) in _motion(recording).items()}
    columns = np.vstack([*motion.values(), recording.signal])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*motion, *recording.channels])
    for row in columns.T.tolist():
        writer.writerow(["" if math.isnan(value) else repr(value) for value in row])
    content = text.getvalue().encode()
    if is_new:
        write_whole(beside, facts)
    try:
        write_whole(path, content, lambda earlier: earlier.startswith(content.split(b"\n")[0]))
    except BadInput:
        if is_new:
            beside.unlink()
        raise


def _check_sidecars(path: Path, facts: bytes) -> bool:
    """Whether there is no sidecar yet; refused where one differs, or where data exist without one,
    as `save` has not written these."""
    other = next((p for s in SUFFIXES[1:] if os.path.lexists(p := path.with_suffix(s))), None)
    beside = path.with_suffix(".json")
    is_new = not os.path.lexists(beside)
    if not is_new and (not beside.is_file() or beside.read_bytes() != facts):
        other = beside
    refuse(
        other is not None,
        f"{path}: there is another sidecar, {other and other.name}, which would be "
        "lost or used for this recording: choose another name, or move it away.",
    )
    refuse(
        is_new and os.path.lexists(path),
        f"{path}: the file exists, without the {beside.name} of a saved recording: "
        "choose another name, or move it away.",
    )
    return is_new


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
    earlier = _check_netcdf(path, f"{sidecar}\n".encode())
    import xarray as xr  # which takes a third of a second

    dataset = xr.Dataset(columns, attrs={"sidecar": sidecar})
    write_whole(path, bytes(dataset.to_netcdf(engine="h5netcdf")), earlier.__eq__)


def _check_netcdf(path: Path, facts: bytes) -> bytes | None:
    """What the file to replace holds. Raises `BadInput` for a file that `save` has not written, and
    where there is a sidecar of another recording."""
    beside = [p for suffix in SUFFIXES if os.path.lexists(p := path.with_suffix(suffix))]
    other = next((p for p in beside if not p.is_file() or p.read_bytes() != facts), None)
    refuse(
        other is not None,
        f"{path}: there is a sidecar, {other and other.name}, which would be used for "
        "this recording: choose another name, or move it away.",
    )
    if not os.path.lexists(path):
        return None
    content = None
    try:
        content = read_bytes(path, what="recording", key="path", most=LARGEST_FILE)
        existing = read_table(path, BY_SUFFIX)
        channels = existing.sidecar.get("channels") or ()
        is_saved = {*existing.columns} - {TIME, SPEED, POSITION} == {*channels}
    except BadInput:
        is_saved = False
    refuse(
        not is_saved,
        f"{path}: the file exists, and is not a saved recording of this name: choose "
        "another name, or move it away.",
    )
    return content


def _motion(recording: Recording) -> dict[str, tuple[np.ndarray, str]]:
    """The columns beside the signals, with their units."""
    columns = {TIME: (recording.time_s, "s"), SPEED: (recording.speed_m_per_s, "m/s")}
    if recording.measured_position_m is not None:
        columns[POSITION] = (recording.measured_position_m, "m")
    return columns


_WRITERS = {".csv": _save_csv, ".nc": _save_netcdf}
