"""Whether a recording can be used and how to go on, and its hum, drift and turns."""

import re
import shlex
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..namespaces import plugin_option
from ..recording.disturbances import Disturbances
from ..recording.drift import common_level
from ..recording.inspection import Inspection
from ..recording.template import essential
from ..report.data import as_pattern, scalars

_PER_ROOT = "signal's unit per root of s"
_READER = "srsinv.recording.formats.BySuffix"
_AS_BY_DEFAULT = {"missing": "refuse", "times": "use", "path": None}
# Text that the command line reads as text without quotation marks.
_PLAIN = re.compile(r"(?!(null|true|false|nan|inf)$)[A-Za-z_/~.][\w/~.+-]*( [\w/~.+-]+)*", re.ASCII)
Variables = dict[str, tuple[Any, ...]]


def verdict(inspection: Inspection, path: str, typed: tuple[str, ...] = ()) -> dict[str, Any]:
    """Whether the recording can be used, in a sentence, and the command to go on with, in which the
    settings `typed` for this look are typed again."""
    needed, given = ", ".join(essential(inspection)), offered(inspection)
    if inspection.refusal and not inspection.overrides:
        said, remedy = "not usable as it is", inspection.refusal
    elif inspection.refusal:
        said, remedy = f"usable with {' '.join(inspection.overrides)}", inspection.refusal
        if any(_key(each) == "time_unit" for each in inspection.overrides):
            said += " (a guess from the stamps: check that unit)"
    else:
        said, remedy = "usable as it is" if not inspection.doubts else "usable", ""
    if inspection.doubts:
        count = len(inspection.doubts)
        what = "what is improbable" if count == 1 else f"{count} findings that are improbable"
        said += f", once you have checked {what} (see below)"
    if needed:
        said += ", once the sidecar has what only you know (see below)"
    found = inspection.disturbances
    said = "; ".join([said, *_described(found)])
    goes_one_way = found is not None and not (found.onwards and found.back)
    if len(inspection.signals) == 1 and goes_one_way:
        said += "; one signal one way: an inversion needs its friction MU, which a fit finds"
        typed = *typed, "friction=MU"
    if any(_key(each) == "quiet_s" for each in given):
        typed = *typed, "rule=evidence"  # which goes by the noise, and that is measured then
    read_as = shlex.join([f"recording.path={_as_typed(path)}", *typed, *given])
    return {
        "verdict": said,
        "refusal": remedy,
        "doubts": " ".join(inspection.doubts),
        "notes": " ".join(inspection.notes),
        "override": shlex.join(given),
        "next_command": ""
        if said.startswith("not")
        else f"srsinv experiment=invert_recording {read_as}",
    }


def settings_of(cfg: Mapping[str, Any]) -> tuple[str, ...]:
    """What a configuration says of its recording, as it is typed, but for the path."""
    return (
        *_overrides("recording", {**cfg["recording"], "path": None}),
        *_overrides("sensor", cfg["sensor"]),
        *_reader(dict(cfg["reader"])),
    )


def _reader(settings: dict[str, Any]) -> Iterator[str]:
    """The reader as it is typed: a plugin by its option in the user's folder, if it has one."""
    target = settings["_target_"]
    if target.startswith("plugins."):
        folder, option = plugin_option("reader", settings)
        yield from ("--config-dir", str(folder))
        if option is not None:
            yield f"reader={option}"
            return
    if target != _READER:
        yield f"reader._target_={target}"
    del settings["_target_"]
    yield from _overrides("+reader", settings)


def _overrides(group: str, settings: Mapping[str, Any]) -> Iterator[str]:
    for key, value in settings.items():
        is_open = isinstance(value, Mapping) and all(each is None for each in value.values())
        if value is not None and not is_open and value != _AS_BY_DEFAULT.get(key):
            yield f"{group}.{key}={_as_typed(value)}"


def _as_typed(value: Any) -> str:
    """A value as the command line reads it."""
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{_as_typed(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{','.join(map(_as_typed, value))}]"
    if isinstance(value, bool) or value is None:
        return {None: "null", True: "true", False: "false"}[value]
    if not isinstance(value, str) or _PLAIN.fullmatch(value):
        return str(value)
    escaped = value.replace("'", "\\'")
    return f"'{escaped}'"


def offered(inspection: Inspection) -> tuple[str, ...]:
    """The settings with which to go on: those that loading needs, and those of what was found and
    is not stated yet."""
    found = inspection.disturbances.overrides if inspection.disturbances else ()
    new = (each for each in found if inspection.facts.get(_key(each)) is None)
    return (*inspection.overrides, *new)


def _key(override: str) -> str:
    return override.partition("=")[0].removeprefix("recording.")


def _described(found: Disturbances | None) -> list[str]:
    if found is None:
        return []
    words, has_drift = [], bool(found.drift.any())
    if found.nominal_Hz:
        ratio = float(np.max(found.hum_ratio))
        words.append(f"hum at {_row(found.nominal_Hz)} Hz, {ratio:.2g} times the rest of the signal"
                     + (", and drift" if has_drift else ""))  # fmt: skip
    elif has_drift:
        words.append("drift")
    if found.turn_margin_m is not None:
        words.append(f"turns act on the signals for {1e3 * found.turn_margin_m:.2g} mm")
    count = found.onwards + found.back
    if count > 1:
        ways = found.onwards, found.back
        each = f"{ways[0]} each way" if ways[0] == ways[1] else f"{ways[0]} onwards, {ways[1]} back"
        words.append(f"{count} passes, {each}")
    return words


def _row(frequencies_Hz: tuple[int, ...]) -> str:
    *first, last = map(str, frequencies_Hz)
    return f"{', '.join(first)} and {last}" if first else last


def of_disturbances(inspection: Inspection) -> tuple[Variables, Variables]:
    """Labels and numbers of hum, drift and passes; none where the recording cannot be loaded."""
    found, signals = inspection.disturbances, len(inspection.signals)
    if found is None or len(found.drift) != signals:
        return {}, {}
    unit, of = "{found_unit_key!s}", "{signal!s}"
    key = found.unit.replace(" ", "_").replace("/", "_per_")
    measured = np.array([line.frequency_Hz for line in found.lines])
    wavelength = found.speed_m_per_s / measured if found.speed_m_per_s else np.nan * measured
    level = common_level(found.drift)
    labels = {
        "mains": ([f"{frequency:.0f}" for frequency in measured], "1"),
        "found_unit_key": ("signal", [key] * signals, "1"),
    }
    return labels, {
        "mains_frequency": ("mains", measured, "Hz", "mains_Hz_{mains!s}"),
        "mains_wavelength": ("mains", wavelength, "m"),
        "hum_rms": ("signal", found.hum_rms, "signal's unit", f"hum_rms_{unit}_{of}"),
        "hum_ratio": ("signal", found.hum_ratio, "1", f"hum_over_rest_{of}"),
        "drift": ("signal", found.drift, _PER_ROOT, f"drift_{unit}_per_sqrt_s_{of}"),
        "drift_level": ((), level, _PER_ROOT, as_pattern(f"drift_{key}_per_sqrt_s")),
        **scalars({"passes": found.onwards + found.back, "passes_onwards": found.onwards,
                   "passes_back": found.back}),
    }  # fmt: skip


def disturbance_facts(inspection: Inspection) -> dict[str, Any]:
    """What the page says of hum and drift besides the numbers."""
    found = inspection.disturbances
    if found is None:
        return {}
    return {
        "found_unit": found.unit,
        "hum": f"at {_row(found.nominal_Hz)} Hz" if found.nominal_Hz else "",
        "travel_speed_m_per_s": found.speed_m_per_s,
        "scan_s": found.duration_s,
    }
