"""A first look at a recorded file: columns, times, clipping, noise, and a sidecar to fill in."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import config
from ..errors import refuse
from ..progress import stage
from ..recording import merge
from ..recording.even import sidecar_paths
from ..recording.inspection import Inspection, inspect
from ..recording.template import blanks, essential, sidecar_template
from ..report.data import dataset, scalars
from ..report.result import Result
from ..report.section import sections
from . import _inspection_plots as own
from ._inspection_verdict import disturbance_facts, of_disturbances, settings_of, verdict

_LONGEST_STEM = 200  # bytes: a file's name has at most 255, with its ending
_SHOWN_ROWS = 20  # of those out of order
_NOT_FACTS = ("path", "cell_m", "sidecar", "calibration")
_DENSITY = "signal_unit per root of frequency"
Variables = dict[str, tuple[Any, ...]]


def run(cfg: Mapping[str, Any]) -> Result:
    """The job: read the table, inspect every column, report, and write a sidecar's template."""
    settings = dict(cfg["recording"])
    path = settings["path"]
    refuse(path is None, "No recording is named: give recording.path=FILE.")
    known = {key: value for key, value in settings.items() if key not in _NOT_FACTS}
    known = merge({}, known | {"sensor": cfg["sensor"]})
    files = sidecar_paths(settings)
    with stage(f"inspecting {path}"):
        inspection = inspect(path, reader=config.reader(cfg), **files, **known)
    stem = Path(path).stem.encode()[:_LONGEST_STEM].decode(errors="ignore")
    template, blank = f"{stem}.yaml", blanks(inspection)
    coordinates, variables = _columns(inspection)
    over_frequency, spectra = _spectra(inspection)
    labels, disturbances = of_disturbances(inspection)
    data = dataset(
        variables | _over_time(inspection) | _of_signals(inspection) | spectra
        | _lines(inspection) | _gaps(inspection) | _numbers(inspection) | disturbances
        | {"hint": ("blank", list(blank.values()), "1")},
        coordinates | over_frequency | labels | {"blank": (list(blank), "1")},
        **_facts(inspection), **disturbance_facts(inspection),
        **verdict(inspection, str(path), settings_of(cfg)),
        template=template,
    )  # fmt: skip
    plots = {"signals": own.signals, "spectra": own.spectra, "motion": own.motion}
    shown = sections("inspect_recording", **plots)
    return Result(_title(inspection), data, shown, {template: sidecar_template(inspection)})


def _title(inspection: Inspection) -> str:
    count, rate = len(inspection.signals), inspection.rate_hz
    at = f"at {rate:.6g} Hz" if rate else "at a rate that is not known"
    words = [f"{count} signal{'s' * (count != 1)} of {_rows(inspection)} samples {at}"]
    if inspection.timing and inspection.timing.gaps:
        gaps = len(inspection.timing.gaps)
        words.append(f"{gaps} gap{'s' * (gaps != 1)}")
    clipped = sum(bool(each.clipping.stretches) for each in inspection.signals.values())
    if clipped:
        words.append(f"{clipped} perhaps clipped")
    return f"{inspection.name}: {', '.join(words)}"


def _rows(inspection: Inspection) -> int:
    return max(column.samples for column in inspection.columns)


def _numbers(inspection: Inspection) -> Variables:
    numbers: dict[str, Any] = {
        "samples": _rows(inspection),
        "columns": len(inspection.columns),
        "signals": len(inspection.signals),
        "sample_rate_hz": inspection.rate_hz,
        "mean_speed_m_per_s": inspection.mean_speed_m_per_s,
    }
    if timing := inspection.timing:
        numbers |= {
            "jitter_rms": timing.jitter_rms,
            "jitter_largest": timing.jitter_largest,
            "gaps": len(timing.gaps),
            "longest_gap_s": max((gap.length_s for gap in timing.gaps), default=0.0),
            "samples_missing": sum(gap.missing for gap in timing.gaps),
            "rows_out_of_order": len(timing.disorder),
        }
    return scalars(numbers)


def _facts(inspection: Inspection) -> dict[str, Any]:
    disorder = inspection.timing.disorder if inspection.timing else ()
    more = " and more" if len(disorder) > _SHOWN_ROWS else ""
    return {
        "recording": inspection.name,
        "time_source": inspection.time_source,
        "is_timed": int(inspection.timing is not None),
        "disorder": ", ".join(map(str, disorder[:_SHOWN_ROWS])) + more,
        "lengths_differ": int(len({each.samples for each in inspection.columns} - {0}) > 1),
        "essential": ", ".join(essential(inspection)),
        "per": "Hz" if inspection.rate_hz else "1/sample",
    }


def _columns(inspection: Inspection) -> tuple[Variables, Variables]:
    """Labels and numbers of each column of the file, in the column's own unit."""
    columns = inspection.columns
    numbers = {
        f"column_{key}": (
            "column",
            [_number(getattr(each, key)) for each in columns],
            "column_unit",
        )
        for key in ("least", "greatest", "mean", "rms")
    }
    words = {
        f"column_{key}": ("column", [getattr(each, key) for each in columns], "1")
        for key in ("role", "unit", "reason", "samples", "missing")
    }
    signals = inspection.signals.values()
    labels = {
        "column": ([each.name for each in columns], "1"),
        "signal": (list(inspection.signals), "1"),
        "unit_key": ("signal", [each.unit.replace(" ", "_").replace("/", "_per_")
                                for each in signals], "1"),
    }  # fmt: skip
    return labels, words | numbers


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _over_time(inspection: Inspection) -> Variables:
    """Signals and motion, row by row; shorter columns end in NaN."""
    signals, rows = inspection.signals, _rows(inspection)
    flat = np.zeros((len(signals), rows), np.int8)
    for row, signal in enumerate(signals.values()):
        for start, stop in signal.clipping.stretches:
            flat[row, start:stop] = 1
    time, unit = _time(inspection, rows)
    values = [_padded(signal.values, rows) for signal in signals.values()]
    over_time = ("signal", "row")
    motion = {
        name: ("row", _padded(values, rows), unit)
        for name, values, unit in (
            ("speed", inspection.speed_m_per_s, "m/s"),
            ("position", inspection.position_m, "m"),
        )
        if values is not None
    }
    return motion | {
        "time": ("row", time, unit),
        "value": (over_time, np.reshape(values, (len(signals), rows)), "signal_unit"),
        "flat": (over_time, flat, "1"),
    }


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    return np.concatenate([values, np.full(size - values.size, np.nan)])


def _time(inspection: Inspection, rows: int) -> tuple[np.ndarray, str]:
    """Times since the first [s]; the sample's index where there are none."""
    if inspection.time_s is not None:
        return _padded(inspection.time_s - _origin(inspection), rows), "s"
    if inspection.rate_hz:
        return np.arange(rows) / inspection.rate_hz, "s"
    return np.arange(rows, dtype=float), "1"


def _origin(inspection: Inspection) -> float:
    """The first stamp [s]."""
    if inspection.time_s is None or not np.isfinite(inspection.time_s).any():
        return 0.0
    return float(inspection.time_s[np.isfinite(inspection.time_s)][0])


def _of_signals(inspection: Inspection) -> Variables:
    """Clipping, rounding and noise of each signal; its metrics have its name and its unit's."""
    every = inspection.signals.values()
    per = "Hz" if inspection.rate_hz else "cycle_per_sample"
    present = [each.values[np.isfinite(each.values)] for each in every]
    rms = [np.sqrt(np.mean(each**2)) if each.size else np.nan for each in present]
    spectra, unit, of = [each.spectrum for each in every], "{unit_key!s}", "{signal!s}"
    strongest = [s.lines[0].frequency_hz if s and s.lines else np.nan for s in spectra]
    per_signal: dict[str, tuple[Any, ...]] = {
        "signal_unit": ([each.unit for each in every], "1"),
        "signal_missing": ([int(np.isnan(each.values).sum()) for each in every], "1",
                           f"missing_{of}"),
        "signal_rms": (rms, "signal_unit", f"rms_{unit}_{of}"),
        "extreme_fraction": ([s.clipping.fraction for s in every], "1", f"extreme_fraction_{of}"),
        "flat_stretches": ([len(s.clipping.stretches) for s in every], "1",
                           f"flat_stretches_{of}"),
        "longest_flat": ([each.clipping.longest for each in every], "1"),
        "clipped": ([each.clipping.verdict for each in every], "1"),
        "step": ([_number(each.step) for each in every], "signal_unit", f"step_{unit}_{of}"),
        "noise_floor": ([s.floor if s else np.nan for s in spectra], _DENSITY,
                        f"noise_floor_{unit}_per_sqrt_{per}_{of}"),
        "strongest_line": (strongest, "Hz" if inspection.rate_hz else "1/sample",
                           f"strongest_line_{per}_{of}"),
    }  # fmt: skip
    return {name: ("signal", *each) for name, each in per_signal.items()}


def _spectra(inspection: Inspection) -> tuple[Variables, Variables]:
    """The frequencies, which all signals have in common, and the amplitude densities there."""
    spectra = [signal.spectrum for signal in inspection.signals.values()]
    frequency = next((s.frequency_hz for s in spectra if s), np.zeros(0))
    nothing = np.full(frequency.size, np.nan)
    densities = [s.density if s else nothing for s in spectra]
    most = max((len(s.lines) for s in spectra if s), default=0)
    lines = [[line.frequency_hz for line in s.lines] if s else [] for s in spectra]
    per = "Hz" if inspection.rate_hz else "1/sample"
    shape = len(spectra), frequency.size
    return {"frequency": (frequency, per)}, {
        "density": (("signal", "frequency"), np.reshape(densities, shape), _DENSITY),
        "line_frequency": (
            ("signal", "line"),
            np.reshape([_padded(np.array(each), most) for each in lines], (len(spectra), most)),
            per,
        ),
    }


def _lines(inspection: Inspection) -> Variables:
    """Every line that stands out, one after the other."""
    every = [
        (name, line.frequency_hz, line.amplitude, signal.unit, line.over_surroundings)
        for name, signal in inspection.signals.items()
        if signal.spectrum
        for line in signal.spectrum.lines
    ]
    per = "Hz" if inspection.rate_hz else "1/sample"
    speed = inspection.mean_speed_m_per_s
    has_length = bool(speed and inspection.rate_hz)
    names, frequency, amplitude, unit, over = zip(*every, strict=True) if every else ((),) * 5
    length = [abs(speed) / f if has_length and speed else np.nan for f in frequency]
    return {
        "peak_signal": ("peak", list(names), "1"),
        "peak_frequency": ("peak", np.array(frequency), per),
        "peak_wavelength": ("peak", np.array(length), "m"),
        "peak_amplitude": ("peak", np.array(amplitude), "signal_unit"),
        "peak_unit": ("peak", list(unit), "1"),
        "peak_over_surroundings": ("peak", np.array(over), "1"),
    }


def _gaps(inspection: Inspection) -> Variables:
    gaps = inspection.timing.gaps if inspection.timing and inspection.time_s is not None else ()
    starts = np.array([gap.start_s - _origin(inspection) for gap in gaps])
    return {
        "gap_start": ("gap", starts, "s"),
        "gap_end": ("gap", starts + np.array([gap.length_s for gap in gaps]), "s"),
        "gap_row": ("gap", np.array([gap.row for gap in gaps], int), "1"),
        "gap_missing": ("gap", np.array([gap.missing for gap in gaps], int), "1"),
    }
