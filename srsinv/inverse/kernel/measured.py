"""A measured kernel with its uncertainty: its values, its file (netCDF-4 of flat columns), and
the sensor that responds by it.
"""

import dataclasses
import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import xarray
from jaxtyping import Float, Shaped

from ...compiled import compiled
from ...errors import LARGEST, refuse
from ...forward.film import Film
from ...forward.measured import KernelTable, MeasuredFilm, integral_of
from ...forward.sensor import FilmSignal, Sensor
from ...grid import as_real
from ...recording.flat_columns import load_columns
from ..diagnostics import OVER_NOISE
from ..quality import is_excess
from ..rig.error import SensorError
from ..rig.setup import Setup
from .lags import Lags

NARROW = 1e-3  # depths: the strip of load that stands for a line


@dataclasses.dataclass(frozen=True)
class MeasuredKernel:
    """The response of a sensor's elements to a line load, from signals over a known input.

    - `lags`: x, the place of the film from the load; `value` (e, 2, m): charge per unit line load
      of p and of q [C m/N], the signal over the amplifier's gain ahead of its filters; `stderr`
      (e, 2, m).
    - `factors` (j, e, 2, m): independent directions of its error, one standard deviation each.
    - `far` (e, 2), `far_factors` (j, e, 2): what the kernel is of that of the sensor as stated
      beyond the lags, and its error in the same directions.
    - `parameters`: (value, standard error) by name of the physical parameters that were fitted;
      empty of a kernel that rests on the data alone.
    - `speed_m_per_s` at which it was measured, `friction` of the known input, and whether it was
      passed both ways: else only K_p + mu K_q at that mu is measured.
    - `chi2_per_freedom` of what it leaves of the signals over the known input, with so many degrees
      of `freedom`.
    - `stats`: further numbers by name.
    """

    lags: Lags
    value: Float[np.ndarray, "e 2 m"]
    stderr: Float[np.ndarray, "e 2 m"]
    factors: Float[np.ndarray, "j e 2 m"]
    far: Float[np.ndarray, "e 2"]
    far_factors: Float[np.ndarray, "j e 2"]
    parameters: Mapping[str, tuple[float, float]]
    speed_m_per_s: float
    friction: float
    has_both_ways: bool
    chi2_per_freedom: float
    freedom: float
    stats: Mapping[str, float]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against it, as sentences."""
        if self.has_both_ways:
            return self.of_residual()
        sign = "-" if self.friction < 0 else "+"
        return (
            f"The known input was scanned in one direction, which determines only the sum K_p "
            f"{sign} {abs(self.friction):.3g} K_q of the kernels. Scan it in both directions, or "
            "invert with this friction only.",
            *self.of_residual(),
        )

    def of_residual(self) -> tuple[str, ...]:
        """A warning where it leaves more than noise of the signals over the known input."""
        if not is_excess(self.chi2_per_freedom, self.freedom, OVER_NOISE):
            return ()
        return (
            f"The residual of the kernel is {np.sqrt(self.chi2_per_freedom):.2g} times the noise "
            "of the signals over the known input, so its bands are too narrow. Check the known "
            "input, the repeatability of the passes and the noise. At very low noise the far "
            "field, which is that of the theory, may cause it.",
        )

    def sensor(self, stated: Sensor) -> Sensor:
        """The sensor with this kernel in place of that of its films; beyond the lags it goes over
        to that of the sensor as stated.

        Raises `BadInput` for another number of elements.
        """
        count = len(self.value)
        refuse(
            len(stated.elements) != count,
            f"The measured kernel has {count} elements, but the sensor has "
            f"{len(stated.elements)}: give the kernel of this sensor.",
        )
        films = stated.elements
        own = kernels(stated, films, self.lags.x_m)
        corrections = self.value - self.far[..., None] * own
        measured = tuple(
            MeasuredFilm.of(film, far, KernelTable.of(self.lags.x_m, correction))
            for film, far, correction in zip(films, self.far, corrections, strict=True)
        )
        return dataclasses.replace(stated, elements=measured)

    @property
    def error(self) -> "KernelError | None":
        """Its uncertainty, as estimates carry it; None of a kernel that is exact."""
        if not len(self.factors):
            return None
        return KernelError(self.lags, self.factors, self.far_factors)


class KernelError(SensorError):
    """The error of a measured kernel, in independent directions: `factors` (j, e, 2, m) [C m/N] at
    the lags, and `far` (j, e, 2) of the stated kernel beyond."""

    lags: Lags = eqx.field(static=True)
    factors: Float[np.ndarray, "j e 2 m"]
    far: Float[np.ndarray, "j e 2"]

    @property
    def words(self) -> str:
        return "a measured kernel"

    def columns(
        self, sensor: Sensor, fitted: Shaped[np.ndarray, "e *sample"], signal_of: Any
    ) -> Shaped[np.ndarray, "j e *sample"]:
        bare = kernels(sensor, [_stated(film) for film in sensor.elements], self.lags.x_m)
        bare = bare[: self.far.shape[1]]
        values = self.factors - self.far[..., None] * bare
        tables = values, integral_of(self.lags.x_m, values), self.far

        def changed_signal(values: Any, integral: Any, far: Any) -> Any:
            return signal_of(Setup(_with_corrections_changed(sensor, values, integral, far)))

        return np.asarray(jax.vmap(changed_signal)(*map(as_real, tables))) - np.asarray(fitted)


def _stated(film: Film) -> Film:
    assert isinstance(film, MeasuredFilm)
    return film.stated


def _with_corrections_changed(sensor: Sensor, values: Any, integral: Any, far: Any) -> Sensor:
    """The sensor with its films' kernels changed by tables (e, 2, m) and factors (e, 2)."""

    def one(row: int, film: Film) -> Film:
        assert isinstance(film, MeasuredFilm)
        own, e = film.correction, row % len(values)
        sums = own.values + values[e], own.integral + integral[e], film.far + far[e]
        return eqx.tree_at(
            lambda f: (f.correction.values, f.correction.integral, f.far), film, sums
        )

    films = tuple(one(row, film) for row, film in enumerate(sensor.elements))
    return eqx.tree_at(lambda s: s.elements, sensor, films)


def kernels(
    sensor: Sensor, films: Sequence[Film], x_m: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "e 2 m"]:
    """The kernels of films in the sensor's skin at lags x: the charge under a unit line load of p
    and of q, of which a strip far narrower than the depth stands for the line."""
    refuse(
        bool(sensor.envelopes),
        "A kernel that is measured includes how the finger touches: leave finite_patch and "
        "fingerprint out of effects.",
    )
    width = NARROW * float(sensor.depth_m)
    stage = FilmSignal(sensor.skin, tuple(films), as_real(1.0), 0)
    return np.asarray(_response(stage, as_real(x_m), as_real(width))) / width


@compiled
def _response(stage: FilmSignal, x_m: Any, width_m: Any):
    return stage.cell_response(x_m, width_m)


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
        f"{name}: the columns of the measured kernel do not match each other: give {key} {WANTED}.",
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
