"""Samples of a recording that say nothing of the surface, taken as missing (without jax).

Stretches that are stuck or clipped (channels.py), and single samples and bursts that stand out of
the noise (outliers.py). One sample of ten times the signal's peak would else ruin an answer. They
are missing before the signal is filtered, so that no filter spreads them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from ._health import SHORTEST
from ._recording import Recording
from .channels import channel_findings, flat_samples, flat_sentences, samples_of
from .outliers import outliers
from .passes import near_turns
from .preparation import prepare

TURNING = 1.0  # depths from a turn within which shear turns over


def without_unusable(recording: Recording, depth_m: float) -> tuple[Recording, tuple[str, ...]]:
    """The recording, at even times and prepared, with its unusable samples missing, and sentences
    on them; the same one where there are none, and where its facts keep them.

    `depth_m`: of the film nearest to the skin.
    """
    raw = recording.signal if recording.raw_signal is None else recording.raw_signal
    if recording.sidecar.get("unusable") == "keep":
        return recording, channel_findings(recording.channels, raw, recording.signal_unit)
    searched = np.where(np.isfinite(recording.signal), raw, np.nan)  # less what is near turns
    mask, sentences = unusable_samples(
        recording.channels, searched, recording.signal_unit,
        recording.speed_m_per_s, recording.position_m, depth_m, recording.sample_rate_hz,
    )  # fmt: skip
    if not mask.any():
        return recording, sentences
    left = np.where(mask, np.nan, raw)
    if recording.raw_signal is None:
        return replace(recording, signal=left), sentences
    again = prepare(replace(recording, signal=left, raw_signal=None))
    # What was left out near turns after the preparation stays left out.
    signal = np.where(np.isfinite(recording.signal), again.signal, np.nan)
    return replace(again, signal=signal), sentences


def unusable_samples(
    channels: Sequence[str],
    raw: Float[np.ndarray, "element sample"],
    unit: str,
    speed_m_per_s: Float[np.ndarray, " sample"],
    position_m: Float[np.ndarray, " sample"],
    depth_m: float,
    rate_hz: float,
) -> tuple[Bool[np.ndarray, "element sample"], tuple[str, ...]]:
    """Which samples, as recorded (NaN: missing), are stuck, clipped or stand out of the noise, and
    sentences on them.

    In a channel of steps above its noise no run and no outlier means anything: it is left as it
    is, and so is one of which fewer than 16 samples would be left.
    """
    mask, is_kept = np.zeros(raw.shape, bool), np.zeros(len(raw), bool)
    said: list[list[str]] = [[] for _ in channels]
    for row, (name, values) in enumerate(zip(channels, raw, strict=True)):
        flat = flat_samples(name, values, unit)
        missing = np.logical_or(*flat.masks(values))
        is_left = int(np.isfinite(values).sum() - missing.sum()) >= SHORTEST
        is_kept[row] = bool(flat.rounded) or not is_left
        mask[row] = missing & is_left
        kept = "" if is_left else "Leave it out of recording.channels"
        said[row] += [flat.rounded] if flat.rounded else flat_sentences(name, flat, values, kept)
    searched = np.where(mask | is_kept[:, None], np.nan, raw)
    # Where shear turns over with the motion the signal is as steep as an outlier, and is no noise.
    turning = near_turns(position_m, TURNING * depth_m)
    found, times = outliers(searched, speed_m_per_s, depth_m, rate_hz, turning)
    for row in map(int, np.flatnonzero(found.any(axis=1))):
        said[row].append(
            f"{channels[row]}: {_stands_out(found[row])} (up to {times[row]:.0f} times), "
            f"{'and is' if found[row].sum() == 1 else 'and are'} taken as missing. Check the "
            "wiring, or record it again."
        )
    return mask | found, tuple(each for words in said for each in words)


def _stands_out(found: Bool[np.ndarray, " sample"]) -> str:
    verb = "stands" if found.sum() == 1 else "stand"
    return f"{samples_of(found)} {verb} out of the noise"
