"""What is improbable in a recording: each finding is a sentence, and no answer from it is sure.

Numbers that a rig can hardly have are nearly always a unit, a scale or a code that was misread.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ._recording import Recording
from ._reports import COARSEST_COUNT_M, MOST

FASTEST_M_PER_S = 1.0  # fingers explore at 0.01 to 0.3 m/s
FASTEST_HZ = 1e6  # the skin transmits up to some kHz at such speeds
SLOWEST_HZ = 10.0  # the skin transmits up to some ten hertz even at 5 mm/s
LONGEST_M = 10.0
_JUMP = 100.0  # times the usual speed
_JUMP_OF_HELD = 10.0  # times the moves before and after
_DISAGREES = 0.1  # of the scan: calibrations of speed are better
DEEPEST_M = 0.02  # rubber of a finger over its film is 0.5 to 3 mm thick
THINNEST_M = 1e-6
_LEAST_IN_WINDOW = 0.5  # of the samples: a scan has an approach beyond its window at most
_FEWEST_PER_DEPTH = 10  # samples while the finger slides by the film's depth
_MODULUS_PA = 7e5  # of rubber, where none is stated
_CHARGE_PER_FORCE = 2e-11  # C/N, of PVDF across its thickness and along its draw
_FAR_ABOVE = 30.0  # times the modulus: the estimate is good to a factor of some three
_ALONE = 10.0  # times the range of all other samples that a code lies beyond them
_FEWEST_CODES = 2
_LEAST_OTHERS = 16


def doubts(recording: Recording) -> tuple[str, ...]:
    """What is improbable in a recording, as sentences that end in what to check."""
    found = (*_of_motion(recording), *_of_signals(recording), *_of_pressure(recording))
    return (*recording.doubts, *found)


def samples_per_depth(recording: Recording) -> str | None:
    """A sentence where the samples are too far apart along x for the film's depth, or None."""
    depth_m = (recording.sidecar.get("sensor") or {}).get("depth_m")
    speed_m_per_s = float(np.max(np.abs(recording.speed_m_per_s)))
    if depth_m is None or speed_m_per_s == 0:
        return None
    samples = float(depth_m) * recording.sample_rate_hz / speed_m_per_s
    if samples >= _FEWEST_PER_DEPTH:
        return None
    return (
        f"The finger slides by the film's depth of {1e3 * depth_m:.3g} mm in {samples:.2g} "
        f"samples, where at least {_FEWEST_PER_DEPTH} show what the skin transmits: check speed "
        "and rate, or record more slowly."
    )


def _of_motion(recording: Recording) -> Iterator[str]:
    speed_m_per_s = float(np.median(np.abs(recording.speed_m_per_s)))
    if speed_m_per_s > FASTEST_M_PER_S:
        yield (
            f"The finger slides at {speed_m_per_s:.3g} m/s, where {FASTEST_M_PER_S:g} m/s is fast: "
            "check the units of times and positions, or of the speed."
        )
    if recording.sample_rate_hz > FASTEST_HZ:
        yield (
            f"The sample rate is {recording.sample_rate_hz:.3g} Hz, above {FASTEST_HZ:g} Hz: check "
            "the unit of the times, or the rate that is stated."
        )
    window_m = recording.sidecar.get("contact_window_m")
    if window_m is not None:
        x = recording.position_m
        share = float(np.mean((window_m[0] <= x) & (x <= window_m[1])))
        if share < _LEAST_IN_WINDOW:
            yield (
                f"The contact window from {window_m[0]:g} m to {window_m[1]:g} m holds "
                f"{100 * share:.0f} % of the scan, which goes from {x.min():g} m to {x.max():g} m: "
                "check recording.contact_window_m and the positions' origin."
            )
    if recording.sample_rate_hz < SLOWEST_HZ:
        yield (
            f"The sample rate is {recording.sample_rate_hz:.3g} Hz, below {SLOWEST_HZ:g} Hz: check "
            "the unit of the times, or the rate that is stated."
        )
    yield from _of_positions(recording)
    sensor = recording.sidecar.get("sensor") or {}
    depths_m = [sensor.get("depth_m"), *(e.get("depth_m") for e in sensor.get("elements") or ())]
    for depth_m in dict.fromkeys(each for each in depths_m if each is not None):
        if not THINNEST_M <= depth_m <= DEEPEST_M:
            yield (
                f"The film's depth is stated as {depth_m:g} m, where {DEEPEST_M:g} m is deep and "
                f"{THINNEST_M:g} m is shallow: check sensor.depth_m, which is in metres."
            )


def _of_positions(recording: Recording) -> Iterator[str]:
    x = recording.position_m
    if np.ptp(x) > LONGEST_M:
        yield (
            f"The scan is {np.ptp(x):.3g} m long, above {LONGEST_M:g} m: check the units of "
            "positions, speed and times."
        )
    if recording.measured_position_m is None:
        return
    moves = np.abs(np.diff(x))
    speeds = moves / np.diff(recording.time_s)
    usual = float(np.median(speeds[moves > 0])) if np.any(moves > 0) else 0.0
    at = int(np.argmax(speeds))
    if speeds[at] > max(FASTEST_M_PER_S, _JUMP * usual):
        yield (
            f"The position jumps by {moves[at]:.3g} m from sample {at + 1} to the next: check "
            "whether a counter begins anew there, or several scans follow one another, and cut "
            "the recording."
        )
    neighbours = (np.append(moves[1:], 0.0) + np.append(0.0, moves[:-1])) / 2
    alone = moves > _JUMP_OF_HELD * neighbours
    # An encoder's counts go by one at a time.
    count_m = float(np.median(moves[alone])) if alone.any() else 0.0
    one = np.mean(np.isclose(moves[alone], count_m, rtol=0.1)) if alone.any() else 1.0
    are_counts = one >= MOST and count_m < COARSEST_COUNT_M
    if moves[alone].sum() > 0.5 * moves.sum() and not are_counts:
        yield (
            "The position stands nearly still and jumps in turn, as if it was reported more slowly "
            "than it is recorded: record the reports alone, or give recording.speed_m_per_s=..."
        )


def disagreement(
    time_s: Float[np.ndarray, " sample"],
    speed_m_per_s: Float[np.ndarray, " sample"] | None,
    position_m: Float[np.ndarray, " sample"] | None,
) -> list[str]:
    """A sentence where a measured speed is not that of the measured positions, else none."""
    if speed_m_per_s is None or position_m is None:
        return []
    mean = (speed_m_per_s[1:] + speed_m_per_s[:-1]) / 2
    travelled_m = np.concatenate(([0.0], np.cumsum(mean * np.diff(time_s))))
    off_m = float(np.ptp(travelled_m - position_m))
    range_m = float(max(np.ptp(position_m), np.ptp(travelled_m)))
    if not off_m > _DISAGREES * range_m:
        return []
    return [
        f"The speed and the positions disagree by {off_m:.3g} m over a scan of {range_m:.3g} m: "
        "check their units and signs, or leave one of the columns out."
    ]


def _of_signals(recording: Recording) -> Iterator[str]:
    raw = recording.signal if recording.raw_signal is None else recording.raw_signal
    for channel, values in zip(recording.channels, raw, strict=True):
        code, count = _code(values)
        if count:
            yield (
                f"{channel} holds {code:.6g} {recording.signal_unit} in {count} samples, far "
                "beyond all others: if that is a code for samples out of range, leave their cells "
                "empty (NaN in an array) and set recording.missing=allow."
            )


def _of_pressure(recording: Recording) -> Iterator[str]:
    """A signal of more pressure than the skin can bear, by order of magnitude: a film of area A at
    depth z gives a current of about d A p v / z."""
    sensor, skin = (recording.sidecar.get(key) or {} for key in ("sensor", "skin"))
    depth_m, ohm = sensor.get("depth_m"), sensor.get("feedback_resistance_ohm")
    speed_m_per_s = float(np.max(np.abs(recording.speed_m_per_s)))
    modulus_Pa = float(skin.get("youngs_modulus_Pa") or _MODULUS_PA)
    elements = sensor.get("elements") or ()
    if recording.signal_unit != "V" or not depth_m or not ohm or not speed_m_per_s:
        return
    for channel, values, element in zip(
        recording.channels, recording.signal, elements, strict=False
    ):
        width_m, length_m = element.get("strip_width_m"), element.get("active_length_m")
        if not width_m or not length_m:
            continue
        coulomb_per_pascal = _CHARGE_PER_FORCE * width_m * length_m
        ampere = float(np.nanmax(np.abs(values - np.nanmean(values)))) / ohm
        pressure_Pa = ampere * depth_m / (coulomb_per_pascal * speed_m_per_s)
        if pressure_Pa > _FAR_ABOVE * modulus_Pa:
            yield (
                f"{channel} reaches {np.nanmax(np.abs(values)):.3g} V after its gain, about "
                f"{pressure_Pa:.1g} Pa on the skin, whose modulus is {modulus_Pa:.3g} Pa: check "
                "recording.gain, the signal's unit, the depth and the feedback resistance."
            )


def _code(values: Float[np.ndarray, " sample"]) -> tuple[float, int]:
    """The value (NaN: missing) that lies alone beyond all others, several times, and how often."""
    present = values[np.isfinite(values)]
    if present.size < _LEAST_OTHERS:
        return 0.0, 0
    low, high = float(present.min()), float(present.max())
    for code in (high, low):
        others = present[present != code]
        if others.size < _LEAST_OTHERS:
            continue
        spread = float(np.ptp(others))
        distance = float(np.min(np.abs(others - code)))
        if present.size - others.size >= _FEWEST_CODES and distance > _ALONE * spread > 0:
            return code, present.size - others.size
    return 0.0, 0
