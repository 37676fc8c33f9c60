"""Measured kernels in files: netCDF-4 of flat columns."""

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray
from jaxtyping import Float

from ...errors import LARGEST, refuse
from ...recording.flat_columns import load_columns
from .lags import Lags
from .measured import MeasuredKernel

KEY = "operator.path"
WANTED = "a kernel.nc that experiment=measure_kernel or fig10_11 wrote"
EVEN = 1e-6  # of the reach, by which lags may be off
UNITS = {  # of the columns; of the last six one number each
    "lag_m": "m",
    "kernel_C_m_per_N": "C m/N",
    "kernel_stderr_C_m_per_N": "C m/N",
    "kernel_error_C_m_per_N": "C m/N",
    "far_field": "1",
    "far_field_error": "1",
    "depth_m": "m",
    "speed_m_per_s": "m/s",
    "friction": "1",
    "has_both_ways": "1",
    "chi2_per_freedom": "1",
    "degrees_of_freedom": "1",
}


def as_netcdf(kernel: MeasuredKernel) -> bytes:
    """The file of a kernel: its lags, its value and standard error (element, component, lag) and
    the directions of its error (direction, element, component, lag), each in one column, and the
    like of its far field."""
    columns = (
        kernel.lags.x_m, kernel.value, kernel.stderr, kernel.factors, kernel.far,
        kernel.far_factors, kernel.lags.depth_m, kernel.speed_m_per_s, kernel.friction,
        kernel.has_both_ways, kernel.chi2_per_freedom, kernel.freedom,
    )  # fmt: skip
    flat = (np.ravel(np.asarray(values, float)) for values in columns)
    return _netcdf(dict(zip(UNITS, flat, strict=True)))


def is_as_written(path: str | os.PathLike[str], key: str = KEY) -> bool:
    """Whether a file is what `as_netcdf` wrote, with nothing changed or added since. Raises
    `BadInput` for a file that holds no kernel."""
    columns = load_columns(path, list(UNITS), key, WANTED)
    return Path(path).read_bytes() == _netcdf(columns)


def _netcdf(columns: Mapping[str, Float[np.ndarray, " row"]]) -> bytes:
    """A file of the columns, with a digest of them that tells one in which a number was changed."""
    variables = {
        name: (f"row_{i}", values, {"units": UNITS[name]})
        for i, (name, values) in enumerate(columns.items())
    }
    digest = hashlib.sha256(b"".join(values.tobytes() for values in columns.values()))
    dataset = xarray.Dataset(variables, attrs={"sha256": digest.hexdigest()})
    return bytes(dataset.to_netcdf(engine="h5netcdf"))


def load_kernel(path: str | os.PathLike[str], key: str = KEY) -> MeasuredKernel:
    """The kernel in a file that `as_netcdf` wrote. Raises `BadInput` for any other file."""
    columns = load_columns(path, list(UNITS), key, WANTED)
    name = Path(path).name
    refuse(
        not _fits(columns),
        f"{name}: the columns of the measured kernel do not fit each other: give {key} {WANTED}.",
    )
    x, value, stderr, factors, far, far_factors, *rest = columns.values()
    depth, speed, friction, both, chi2, freedom = (float(each[0]) for each in rest)
    shape = -1, 2, x.size
    whole = value.reshape(shape)
    return MeasuredKernel(
        Lags(depth, float(x[-1])), whole, stderr.reshape(shape),
        factors.reshape(-1, *whole.shape), far.reshape(-1, 2),
        far_factors.reshape(-1, len(whole), 2), {}, speed, friction, bool(both),
        chi2, freedom, {},
    )  # fmt: skip


def _fits(columns: Mapping[str, Float[np.ndarray, " row"]]) -> bool:
    """Whether the columns are of one kernel."""
    x, value, stderr, factors, far, far_factors, *rest = columns.values()
    if not all(each.size == 1 for each in rest) or x.size < 2 or not value.size:
        return False
    depth, speed, *_ = (float(each[0]) for each in rest)
    if not (0 < depth <= LARGEST and speed and 0 < x[-1] <= LARGEST):
        return False
    if not far.size or value.size != far.size * x.size:
        return False
    if far.size % 2 or stderr.size != value.size or factors.size % value.size:
        return False
    lags = Lags(depth, float(x[-1]))
    if lags.count != x.size:  # before an array of them is made
        return False
    directions = factors.size // value.size
    is_even = bool(np.abs(lags.x_m - x).max() <= EVEN * x[-1])
    return is_even and far_factors.size == directions * far.size
