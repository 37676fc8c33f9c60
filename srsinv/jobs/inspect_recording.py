"""A first look at a recorded file: columns, times, clipping, noise, and a sidecar to fill in."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from .. import config
from ..errors import refuse
from ..recording import merge
from ..recording.inspection import Column, Inspection, inspect
from ..recording.template import blanks, sidecar_template
from ..report import figures
from ..report.outcome import Outcome, Section, Table

_NONE = "–"
_LONGEST_STEM = 200  # bytes: a file's name has at most 255, with its ending
_SHOWN_GAPS = 20
_NOT_FACTS = ("path", "missing", "times", "cell_m", "sidecar")


def run(cfg: Mapping[str, Any]) -> Outcome:
    """The job: read the table, inspect every column, report, and write a sidecar's template."""
    settings = dict(cfg["recording"])
    path = settings["path"]
    refuse(path is None, "No recording is named: give recording.path=FILE.")
    known = {key: value for key, value in settings.items() if key not in _NOT_FACTS}
    known = merge({}, known | {"sensor": cfg["sensor"]})
    inspection = inspect(path, reader=config.reader(cfg), sidecar=settings.get("sidecar"), **known)
    dataset = _dataset(inspection)
    stem = Path(path).stem.encode()[:_LONGEST_STEM].decode(errors="ignore")
    template = f"{stem}.yaml"
    return Outcome(
        f"{inspection.name}: what the file holds",
        _metrics(inspection),
        dataset,
        (
            _columns(inspection),
            _times(inspection),
            _signals(inspection, dataset),
            _noise(inspection, dataset),
            *_motion(inspection, dataset),
            _sidecar(inspection, template),
        ),
        _summary(inspection, template),
        {template: sidecar_template(inspection)},
    )


def _metrics(inspection: Inspection) -> dict[str, Any]:
    metrics: dict[str, Any] = {
        "samples": max(column.samples for column in inspection.columns),
        "columns": len(inspection.columns),
        "signals": len(inspection.signals),
        "sample_rate_hz": inspection.rate_hz,
        "mean_speed_m_per_s": inspection.mean_speed_m_per_s,
    }
    if timing := inspection.timing:
        metrics |= {
            "jitter_rms": timing.jitter_rms,
            "jitter_largest": timing.jitter_largest,
            "gaps": len(timing.gaps),
            "longest_gap_s": max((gap.length_s for gap in timing.gaps), default=0.0),
            "samples_missing": sum(gap.missing for gap in timing.gaps),
            "rows_out_of_order": len(timing.disorder),
        }
    for column in inspection.of_role("signal"):
        signal, unit = inspection.signals[column.name], _key(inspection.signals[column.name].unit)
        present = signal.values[np.isfinite(signal.values)]
        spectrum = signal.spectrum
        metrics |= {
            f"missing_{column.name}": column.missing,
            f"rms_{unit}_{column.name}": (
                float(np.sqrt(np.mean(present**2))) if present.size else None
            ),
            f"extreme_fraction_{column.name}": signal.clipping.fraction,
            f"flat_stretches_{column.name}": len(signal.clipping.stretches),
            f"step_{unit}_{column.name}": signal.step,
            f"noise_floor_{unit}_per_sqrt_{'Hz' if inspection.rate_hz else 'cycle_per_sample'}"
            f"_{column.name}": spectrum.floor if spectrum else None,
            f"strongest_line_{'Hz' if inspection.rate_hz else 'cycle_per_sample'}_{column.name}": (
                spectrum.lines[0].frequency_hz if spectrum and spectrum.lines else None
            ),
        }
    return metrics


def _key(unit: str) -> str:
    return unit.replace(" ", "_").replace("/", "_per_")


def _dataset(inspection: Inspection) -> xarray.Dataset:
    """Signals, spectra and motion as drawn; shorter columns end in NaN."""
    signals = inspection.signals
    rows = max(column.samples for column in inspection.columns)
    spectra = [signal.spectrum for signal in signals.values()]
    frequency = next((s.frequency_hz for s in spectra if s), np.zeros(0))
    nothing = np.full(frequency.size, np.nan)
    most = max((len(s.lines) for s in spectra if s), default=0)
    lines = [[line.frequency_hz for line in s.lines] if s else [] for s in spectra]
    per = "Hz" if inspection.rate_hz else "1/sample"
    flat = np.zeros((len(signals), rows), np.int8)
    for row, signal in enumerate(signals.values()):
        for start, stop in signal.clipping.stretches:
            flat[row, start:stop] = 1
    time, time_unit = _time(inspection, rows)
    gaps = inspection.timing.gaps if inspection.timing and inspection.time_s is not None else ()
    origin = _origin(inspection)
    starts = np.array([gap.start_s - origin for gap in gaps])
    of_signal, over_time = ("signal",), ("signal", "row")
    values = [_padded(signal.values, rows) for signal in signals.values()]
    variables: dict[str, tuple[Any, Any, dict[str, str]]] = {
        "time": ("row", time, {"units": time_unit}),
        "value": (over_time, np.reshape(values, (len(signals), rows)), {"units": "signal_unit"}),
        "flat": (over_time, flat, {"units": "1"}),
        "signal_unit": (of_signal, [signal.unit for signal in signals.values()], {"units": "1"}),
        "density": (
            ("signal", "frequency"),
            np.reshape(
                [s.density if s else nothing for s in spectra], (len(signals), frequency.size)
            ),
            {"units": "signal_unit per root of frequency"},
        ),
        "noise_floor": (
            of_signal,
            [s.floor if s else np.nan for s in spectra],
            {"units": "signal_unit per root of frequency"},
        ),
        "line_frequency": (
            ("signal", "line"),
            np.reshape([_padded(np.array(each), most) for each in lines], (len(signals), most)),
            {"units": per},
        ),
        "gap_start": ("gap", starts, {"units": "s"}),
        "gap_end": ("gap", starts + np.array([gap.length_s for gap in gaps]), {"units": "s"}),
    }
    for name, values, unit in (
        ("speed", inspection.speed_m_per_s, "m/s"),
        ("position", inspection.position_m, "m"),
    ):
        if values is not None:
            variables[name] = ("row", _padded(values, rows), {"units": unit})
    coordinates = {
        "signal": ("signal", list(signals), {"units": "1"}),
        "frequency": ("frequency", frequency, {"units": per}),
    }
    return xarray.Dataset(variables, coordinates)


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    return np.concatenate([values, np.full(size - values.size, np.nan)])


def _origin(inspection: Inspection) -> float:
    """The first stamp [s]."""
    if inspection.time_s is None or not np.isfinite(inspection.time_s).any():
        return 0.0
    return float(inspection.time_s[np.isfinite(inspection.time_s)][0])


def _time(inspection: Inspection, rows: int) -> tuple[np.ndarray, str]:
    """Times since the first [s]; the sample's index where there are none."""
    if inspection.time_s is not None:
        return _padded(inspection.time_s - _origin(inspection), rows), "s"
    if inspection.rate_hz:
        return np.arange(rows) / inspection.rate_hz, "s"
    return np.arange(rows, dtype=float), "1"


# --- the page --------------------------------------------------------------------------------


def _summary(inspection: Inspection, template: str) -> Table:
    rows = tuple(_summary_row(inspection, column) for column in inspection.columns)
    columns = ("column", "role", "unit", "least", "greatest", "rms", "missing", "clipped", "noise")
    return Table(
        columns,
        rows,
        f"{inspection.name}: {_timing_in_words(inspection)} Noise is the floor of the amplitude "
        "density, per "
        f"root {'Hz' if inspection.rate_hz else '1/sample'}; {template} is a sidecar to fill in.",
    )


def _summary_row(inspection: Inspection, column: Column) -> tuple[Any, ...]:
    signal = inspection.signals.get(column.name)
    spectrum = signal.spectrum if signal else None
    clipped = signal.clipping.verdict if signal else _NONE
    noise = f"{spectrum.floor:.3g} {signal.unit}" if signal and spectrum else _NONE
    return (
        column.name,
        column.role,
        column.unit,
        *map(_or_none, (column.least, column.greatest, column.rms)),
        column.missing,
        clipped,
        noise,
    )


def _or_none(value: float | None) -> float | str:
    return _NONE if value is None else value


def _columns(inspection: Inspection) -> Section:
    rows = tuple(
        (
            column.name,
            column.role,
            column.unit,
            column.reason,
            column.samples,
            column.missing,
            *map(_or_none, (column.least, column.greatest, column.mean, column.rms)),
        )
        for column in inspection.columns
    )
    headings = ("column", "role", "unit", "because", "samples", "missing")
    return Section(
        "Columns",
        (
            "What each column seems to be, from its name, what the file and the sidecar state, and "
            "its values. Numbers are in the column's own unit. A role or a unit that is wrong is "
            "set right in the sidecar (last part of this page), or by the column's name.",
        ),
        tables=(Table((*headings, "least", "greatest", "mean", "rms"), rows),),
    )


def _timing_in_words(inspection: Inspection) -> str:
    samples = max(column.samples for column in inspection.columns)
    if inspection.rate_hz is None:
        return f"{samples} samples; the sample rate is not known ({inspection.time_source})."
    if inspection.timing is None:
        rate_hz, source = inspection.rate_hz, inspection.time_source
        return f"{samples} samples at {rate_hz:.6g} Hz, as stated ({source})."
    gaps, disorder = inspection.timing.gaps, inspection.timing.disorder
    missing = sum(gap.missing for gap in gaps)
    words = f"{_several(len(gaps), 'gap')} with about {missing} samples lost" if gaps else "no gaps"
    order = f"; {_several(len(disorder), 'row')} out of the order of time" if disorder else ""
    return f"{samples} samples at {inspection.rate_hz:.6g} Hz, {words}{order}."


def _times(inspection: Inspection) -> Section:
    paragraphs = [_timing_in_words(inspection), f"Times: {inspection.time_source}."]
    tables = []
    if timing := inspection.timing:
        paragraphs.append(
            f"Intervals stray from their mean by {timing.jitter_rms:.2g} of it (rms) and by "
            f"{timing.jitter_largest:.2g} at most, gaps aside."
        )
        if timing.disorder:
            first = ", ".join(map(str, timing.disorder[:_SHOWN_GAPS]))
            paragraphs.append(
                f"Data rows that do not come after the row before: {first}"
                f"{' and more' if len(timing.disorder) > _SHOWN_GAPS else ''}. They have to be "
                "dropped or sorted before the recording can be used."
            )
        if timing.gaps:
            tables.append(_gaps(inspection))
    sizes = {column.samples for column in inspection.columns if column.samples}
    if len(sizes) > 1:
        paragraphs.append("The columns differ in length, so the recording cannot be used as it is.")
    return Section("Times", tuple(paragraphs), tables=tuple(tables))


def _gaps(inspection: Inspection) -> Table:
    gaps = inspection.timing.gaps if inspection.timing else ()
    longest = sorted(gaps, key=lambda gap: gap.length_s, reverse=True)[:_SHOWN_GAPS]
    rows = tuple(
        (gap.row, gap.start_s - _origin(inspection), gap.length_s, gap.missing) for gap in longest
    )
    columns = ("after data row", "since the first sample [s]", "length [s]", "samples lost, about")
    return Table(columns, rows, f"The longest of {_several(len(gaps), 'gap')}")


def _several(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _signals(inspection: Inspection, dataset: xarray.Dataset) -> Section:
    if not inspection.signals:
        return Section("Signals", ("No column seems to be a signal.",))
    rows = tuple(
        (
            name,
            100 * signal.clipping.fraction,
            len(signal.clipping.stretches),
            signal.clipping.longest,
            signal.clipping.verdict,
            _NONE if signal.step is None else f"{signal.step:.4g} {signal.unit}",
            int(np.isnan(signal.values).sum()),
        )
        for name, signal in inspection.signals.items()
    )
    headings = ("signal", "at the extremes [%]", "flat stretches", "longest [samples]")
    table = Table(
        (*headings, "clipped", "step between values", "missing"), rows, "Clipping and rounding"
    )
    return Section(
        "Signals",
        (
            "A signal that meets the end of its range stays flat there: three equal samples or "
            "more in a row at the least or the greatest value are marked. Once can be a slow "
            "signal at rest in coarse steps; again and again is clipping, and the gain was too "
            "high. A step between values is that of the converter.",
        ),
        {"recorded_signals": lambda: figures.recorded_signals(dataset)},
        {
            "recorded_signals": "The signals as recorded, in the file's order. Shaded: gaps in the "
            "times; red: flat stretches at an extreme."
        },
        (table,),
    )


def _noise(inspection: Inspection, dataset: xarray.Dataset) -> Section:
    per = "Hz" if inspection.rate_hz else "1/sample"
    floors = tuple(
        (name, f"{signal.spectrum.floor:.3g} {signal.unit}", signal.spectrum.floor / signal.step
         if signal.step else _NONE)
        for name, signal in inspection.signals.items() if signal.spectrum
    )  # fmt: skip
    if not floors:
        return Section("Noise", ("No signal varies for long enough to have a spectrum.",))
    spacing = float(dataset["frequency"].values[0])
    speed = inspection.mean_speed_m_per_s
    lines = tuple(
        (
            name,
            line.frequency_hz,
            1e3 * abs(speed) / line.frequency_hz if speed and inspection.rate_hz else _NONE,
            f"{line.amplitude:.3g} {signal.unit}",
            line.over_surroundings,
        )
        for name, signal in inspection.signals.items()
        if signal.spectrum
        for line in signal.spectrum.lines
    )
    tables = [Table(("signal", f"floor per root {per}", "floor over step"), floors, "Noise floor")]
    if lines:
        headings = ("signal", f"frequency [{per}]", "wavelength [mm]", "amplitude")
        tables.append(Table((*headings, "power over surroundings"), lines, "Lines that stand out"))
    return Section(
        "Noise",
        (
            "Averaged spectra (Welch, Hann window, trend removed) at the mean rate, gaps closed "
            "and missing samples drawn from their neighbours. The floor is the level of the upper "
            "half of the band, as white noise would have it: a touch is slower than that. "
            f"Frequencies are told apart {spacing:.3g} {per} from each other. A "
            "line near 50 or 60 Hz and its multiples is the mains; one whose "
            "frequency follows the speed is the surface, its wavelength given at the mean speed "
            "where that is known.",
        ),
        {"noise_spectra": lambda: figures.noise_spectra(dataset)},
        {"noise_spectra": "Amplitude density of each signal, its noise floor, and the lines that "
         "stand at least tenfold in power above their surroundings."},
        tuple(tables),
    )  # fmt: skip


def _motion(inspection: Inspection, dataset: xarray.Dataset) -> tuple[Section, ...]:
    if inspection.speed_m_per_s is None and inspection.position_m is None:
        return ()
    return (
        Section(
            "Motion",
            ("Without a column of speed, the speed is derived from the position on loading.",),
            {"recorded_motion": lambda: figures.recorded_motion(dataset)},
            {"recorded_motion": "Speed and position as the file has them."},
        ),
    )


def _sidecar(inspection: Inspection, template: str) -> Section:
    rows = tuple(blanks(inspection).items())
    return Section(
        "The sidecar",
        (
            f"{template}, in the folder of this page, says what the file shows and leaves blank "
            "what only the experimenter knows. Fill in what you know, leave the rest null (not "
            f"given), and put it beside {inspection.name}, in place of another sidecar there. "
            "Then: "
            "srsinv experiment=invert_recording recording.path=FILE. Each value can also be "
            "given on the command line.",
        ),
        tables=(Table(("key", "what to write"), rows, "Left blank"),),
    )
