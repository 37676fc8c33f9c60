"""The methods whose bands are calibrated, by the configuration."""

from collections.abc import Iterator, Mapping
from typing import Any

from srsinv import config
from srsinv.errors import echo, mapping, number, refuse
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.sensor import Sensor
from srsinv.grid import Open, Periodic
from srsinv.inverse.features.fit import FeatureFitter
from srsinv.inverse.features.synthetic import (
    KnownLoad,
    KnownShape,
    SampledScan,
    SceneShape,
    SyntheticScan,
)
from srsinv.inverse.gridding.cells import Window
from srsinv.inverse.wiener import Exponential
from srsinv.report.text import listed

from .fits import Ranges, RankedFit, RankedLoad, RankedPitch, RankedSurface
from .inversions import (
    DrawnScan,
    RankedAdmissible,
    RankedInversion,
    RankedLinear,
    RankedLive,
    RankedSamples,
    TimedScan,
)
from .ranks import RankedMethod
from .rigs import RankedDirection, RankedFacts, RankedRig

BROKEN = "bands too narrow on purpose"


def ranked_methods(cfg: config.Config) -> list[RankedMethod]:
    """The methods that `calibration_of_bands.methods` names, in any case; all for null.

    Raises `BadInput` for names of none, and refusals of the configuration's parts.
    """
    names = cfg["calibration_of_bands"]["methods"]
    refuse(
        not isinstance(names, list | None),
        f"calibration_of_bands.methods is {echo(names)}: give a list of labels, or null for all.",
    )
    every = list(_methods(cfg))
    if names is None:
        return every
    labels = {method.label.lower(): method for method in every}
    asked = [str(each).lower() for each in names]
    unknown = [each for each in asked if each not in labels]
    refuse(
        bool(unknown) or not asked,
        f"calibration_of_bands.methods names {', '.join(unknown) or 'none'}: give some of "
        f"{', '.join(map(repr, labels))}.",
    )
    return [labels[each] for each in asked]


def _methods(cfg: config.Config) -> Iterator[RankedMethod]:
    """All methods, by the configuration's sensor, scan, noise and grid."""
    settings = cfg["calibration_of_bands"]
    sensor, scan, noises = config.sensor(cfg), config.scan(cfg), config.noises(cfg)
    scan.require_onwards()
    refuse(
        len(sensor.elements) != 2,
        f"The sensor has {len(sensor.elements)} elements, but p and q are tested with two: give "
        "sensor=two_element.",
    )
    line, spectrum = config.line(cfg), prior_spectrum(cfg)
    start = float(line.start_m)
    whole_line = Periodic(line.n, float(line.cell_m), start)
    # Of an open scan the direct path solves at most some hundred cells in no time.
    open_line = Open(line.n // 2, 2 * float(line.cell_m), start)
    of = sensor, scan, noises, spectrum
    on_whole, on_open = DrawnScan.of(whole_line, *of), DrawnScan.of(open_line, *of)
    inversions = config.methods(cfg)
    for name, method in inversions.items():
        yield RankedInversion(name, method, on_whole)
    for name, method in inversions.items():
        yield RankedInversion(
            f"{name}, open with gaps", method, on_open, is_quick=not method.chooses_prior
        )
    name, method = next(iter(inversions.items()))
    factor = number("calibration_of_bands.broken", settings["broken"], "a positive factor", above=0)
    yield RankedInversion(f"{name}, {BROKEN}", method, on_whole, too_narrow=factor)
    yield RankedAdmissible(on_whole, spectrum)
    timed = TimedScan(sensor, float(scan.speed_m_per_s), spectrum)
    yield RankedSamples(timed)
    yield RankedLive(timed)
    yield RankedLinear("LinearProblem, direct", "direct")
    yield RankedLinear("LinearProblem, spectral", "spectral")
    yield from _features(cfg, settings, sensor, scan)
    yield RankedRig(sensor, float(scan.speed_m_per_s))
    yield RankedFacts(sensor, scan, spectrum)
    yield RankedDirection(sensor)
    yield RankedPitch()
    yield RankedFit("srsinv.fit", is_sampled=False, is_quick=True)
    yield RankedFit("srsinv.sample (NUTS)", is_sampled=True, is_quick=False)


def prior_spectrum(cfg: config.Config) -> Exponential:
    """The spectrum of p and of q from which tractions are drawn."""
    key, given = "calibration_of_bands.prior", cfg["calibration_of_bands"]["prior"]
    given, wanted = mapping(key, given), "a positive number"
    names = "rms_Pa", "correlation_m"
    return Exponential(*(number(f"{key}.{each}", given[each], wanted, above=0) for each in names))


def _features(
    cfg: config.Config, settings: Mapping[str, Any], sensor: Sensor, scan: ConstantSpeed
) -> Iterator[RankedMethod]:
    """Fits of the features that ranges are given of, and of the scene's shape."""
    key, solver = "calibration_of_bands.ranges", config.solver(cfg)
    given = mapping(key, settings["ranges"])
    rate = number("calibration_of_bands.sample_rate_hz", settings["sample_rate_hz"],
                  "a positive number in Hz", above=0)  # fmt: skip
    sampled = SampledScan("calibration_of_bands", rate, sensor, scan, config.noises(cfg))
    for name, feature in config.features(cfg).items():
        refuse(name not in given, f"{key} has no {name}: give the ranges of its parameters.")
        parts = [*feature.axes, feature.amplitude, "friction"]
        ranges = Ranges.checked(f"{key}.{name}", given[name], parts)
        refuse(
            len(ranges.of) < len(parts),
            f"{key}.{name} has no {listed(set(parts) - set(ranges.of))}: give a range of each.",
        )
        on = SyntheticScan.along(config.line(cfg), sampled)
        fitter = FeatureFitter.along(sensor, on.motion, solver)
        yield RankedLoad(
            f"Fit of {name.replace('_', ' ')}",
            KnownLoad(on, name, ranges.middle, feature, fitter), ranges,
        )  # fmt: skip
    names = list(config.part(cfg, "scene").get("surfaces") or ())
    if not names:
        return
    shape = SceneShape.of(config.scene(cfg), names, {})
    refuse(
        shape.name not in given, f"{key} has no {shape.name}: give the ranges of its parameters."
    )
    line = config.line(cfg)
    part = number("calibration_of_bands.surface_window", settings["surface_window"],
                  "a positive number", above=0)  # fmt: skip
    half = line.n * float(line.cell_m) / 2 * part
    known = KnownShape.in_window(shape, sampled, Window(-half, half), solver)
    ranges = Ranges.checked(f"{key}.{shape.name}", given[shape.name], list(shape.truth))
    yield RankedSurface(f"Fit of a {shape.name.replace('_', ' ')}", known, ranges)
