"""A recording's signal less its hum, averaged over passes: hum of 1 V hides a feature of 10 mV in a
figure of the samples, although the fit estimates both."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..forward.scan import Motion
from ..recording.mains import MainsLine, waves
from ..recording.passes import passes_of

MOST_PLACES = 600  # bins of position: more than a figure has pixels
LEAST_SAMPLES = 4.0  # of a pass in a bin, in the mean
TOWARDS = {True: "towards +x", False: "towards −x"}


def hum_free_variables(
    motion: Motion,
    mains: Sequence[MainsLine],
    noise_rms: float,
    data: Float[np.ndarray, "e sample"],
    fitted: Float[np.ndarray, "e sample"],
    unit: str,
) -> tuple[dict[str, tuple[Any, ...]], dict[str, tuple[Any, ...]]]:
    """The signal less the expected hum and the fitted signal, means over the passes of each
    direction of motion in bins of position, as variables and coordinates; nothing where no line of
    mains is part of the model.

    The amplitudes c of the waves C of mains are normal of variance one; in the residual r with
    white noise of rms s = `noise_rms` their expected values are (C C^T + s^2)^-1 C r.
    """
    if not mains or data.shape != fitted.shape:
        return {}, {}
    columns = waves(np.asarray(motion.time_s, float), mains, noise_rms)
    if columns.shape[1] == 0 or columns.shape[2] != data.shape[1]:
        return {}, {}
    is_missing = ~np.isfinite(data)
    residual = np.where(is_missing, 0.0, data - fitted)
    columns = np.where(is_missing[:, None], 0.0, columns)
    among = np.einsum("emn,ekn->emk", columns, columns) + noise_rms**2 * np.eye(columns.shape[1])
    sizes = np.linalg.solve(among, np.einsum("emn,en->em", columns, residual)[..., None])[..., 0]
    clean = data - np.einsum("em,emn->en", sizes, columns)
    place, rows = _averaged(np.asarray(motion.position_m, float), np.stack([clean, fitted]))
    by = ("direction", "element", "place")
    return (
        {"hum_free_signal": (by, rows[:, 0], unit), "hum_free_fit": (by, rows[:, 1], unit)},
        {"direction": (list(TOWARDS.values()), "1"), "place": (place, "m")},
    )


def _averaged(
    position_m: Float[np.ndarray, " sample"], signals: Float[np.ndarray, "kind e sample"]
) -> tuple[Float[np.ndarray, " place"], Float[np.ndarray, "direction kind e place"]]:
    """The middles of bins of position, and the signals' means in each over the passes of each
    direction of motion, NaN where a bin has no sample."""
    passes = passes_of(position_m)
    samples = position_m.size / max(len(passes), 1)
    count = int(np.clip(samples / LEAST_SAMPLES, 8, MOST_PLACES))
    edges = np.linspace(position_m.min(), position_m.max(), count + 1)
    bins = np.clip(np.searchsorted(edges, position_m, side="right") - 1, 0, count - 1)
    rows = np.full((len(TOWARDS), *signals.shape[:2], count), np.nan)
    for d, is_onwards in enumerate(TOWARDS):
        own = [np.arange(position_m.size)[each.samples] for each in passes
               if each.is_onwards == is_onwards]  # fmt: skip
        if not own:
            continue
        at = np.concatenate(own)
        for kind, e in np.ndindex(*signals.shape[:2]):
            values = signals[kind, e, at]
            good = np.isfinite(values)
            number = np.bincount(bins[at][good], minlength=count)
            total = np.bincount(bins[at][good], values[good], minlength=count)
            rows[d, kind, e] = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    return (edges[1:] + edges[:-1]) / 2, rows
