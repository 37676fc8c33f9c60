"""Refusals of a problem on a line."""

import math
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
from jax.core import Tracer

from ..errors import all_of_kind, choice, number, refuse, shown
from ..status import Status


def check(line, forward, data, noise, observed, friction, known_mean_Pa) -> None:
    """Refuse what [`LineProblem`][] refuses."""
    elements = forward.transfer.shape[0]
    is_observed = _checked_shapes((elements, line.n), line, data, noise, observed)
    refuse(
        friction is None and elements < 2,
        "One element cannot tell p from q: give friction (q = mu p) or a second element.",
    )
    count = int(np.sum(np.any(is_observed, axis=0)))
    refuse(count < 3, f"Only {count} samples are there: an inversion needs at least 3.")
    if not isinstance(data, Tracer):
        bad = is_observed & ~np.isfinite(np.asarray(data))
        refuse(
            bool(bad.any()),
            f"The data hold {int(bad.sum())} samples that are nan or infinite: mark them as not "
            "there in observed, or correct them.",
        )
    if not isinstance(noise, Tracer):
        _check_noise(np.asarray(noise))
    means = zip(("known mean of p", "known mean of q"), known_mean_Pa, strict=True)
    for name, value in (("friction", friction), *means):
        refuse(
            value is not None and not isinstance(value, Tracer) and not np.isfinite(value),
            f"The {name} is {value}: give a finite number.",
        )
    if not isinstance(forward.transfer, Tracer):
        refuse(
            not bool(np.any(np.asarray(forward.transfer))),
            "The model's signal is zero for every traction (no speed, or no gain): there is "
            "nothing to invert.",
        )


def _checked_shapes(shape: tuple[int, int], line, data, noise, observed) -> np.ndarray:
    """The mask of valid samples, of this shape as the data."""
    refuse(
        data.shape != shape,
        f"The data have shape {data.shape}: the model expects (element, sample) = {shape}.",
    )
    refuse(
        noise.shape not in ((1, *line.k.shape), (shape[0], *line.k.shape)),
        f"The noise has shape {noise.shape}: give its power at the {line.n // 2 + 1} wavenumbers "
        "line.k, one row for all elements or one for each.",
    )
    is_observed = np.ones(shape, bool) if observed is None else np.asarray(observed)
    refuse(
        is_observed.shape != shape,
        f"observed has shape {is_observed.shape}: give one truth value for each of {shape}.",
    )
    return is_observed


def _check_noise(power: np.ndarray) -> None:
    is_free = np.isinf(power[:, 0]).all()
    usable = (power > 0) & np.isfinite(power)
    usable[:, 0] |= is_free
    row, worst = np.unravel_index(int(np.argmin(usable)), power.shape)
    refuse(
        not usable.all(),
        f"The noise is {power[row, worst] or 'zero'} at wavenumber number {worst}: give a power "
        "above 0 (infinite at number 0 alone, for an offset that is not known).",
    )


def check_nuisance(shape: tuple[int, ...], columns: Any) -> None:
    """Refuse columns that are not finite, or not of the data's shape."""
    if columns is None or isinstance(columns, Tracer):
        return
    fits = columns.ndim == 3 and (columns.shape[0], columns.shape[2]) == shape
    refuse(
        not fits or not bool(np.isfinite(np.asarray(columns)).all()),
        f"The nuisance has the shape {columns.shape}: give finite numbers (element, column, "
        f"sample), of the {shape[0]} elements and {shape[1]} samples of the data.",
    )


def check_noise_scale(shape: tuple[int, ...], scale: Any) -> None:
    """Refuse factors on the noise that are not positive, or not of the data's shape."""
    if scale is None or isinstance(scale, Tracer):
        return
    values = np.asarray(scale)
    refuse(
        values.shape != shape or not bool(np.all(np.isfinite(values) & (values > 0))),
        f"noise_scale is {shown(values)}: give a positive factor on the noise's standard deviation "
        f"for each of the samples, {shape}.",
    )


def unboxed(value: Any) -> Any:
    """A number of an array as Python's; anything else as it is."""
    return value.item() if getattr(value, "ndim", None) == 0 else value


def check_estimate(
    shape: tuple[int, int],
    parts: Mapping[str, Any],
    status: Any,
    resolved_dof: Any,
    warnings: Any,
    stats: Mapping[str, Any],
) -> None:
    """Refuse what a method says of its solution of this shape, `traction` and `stderr` (None where
    there is none) by name, where it cannot be."""
    choice("status", status, list(Status))
    wanted = f"a number from 0 to {math.prod(shape)}, of as many unknowns"
    number("resolved_dof", resolved_dof, wanted, least=0, most=math.prod(shape))
    all_of_kind("warnings", warnings, str, "sentences")
    for name, value in stats.items():
        refuse(
            not (value is None or isinstance(value, str | Real)),
            f"stats has {name} = {shown(value)}: give a number or a word, as float(...) makes one.",
        )
    given = {name: np.asarray(values) for name, values in parts.items() if values is not None}
    for name, values in given.items():
        refuse(
            values.shape != shape,
            f"The {name} has the shape {values.shape}: give (component, cell), as they are solved "
            f"for: {shape}.",
        )
    stderr = given.get("stderr", np.zeros(shape))
    refuse(
        bool(np.any((stderr < 0) | np.isinf(stderr))),
        "stderr has negative or infinite numbers: give NaN where it is not known.",
    )
