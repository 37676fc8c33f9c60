"""The methods whose bands are calibrated, by the configuration."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from typing import Any

from srsinv import config
from srsinv.errors import echo, mapping, number, refuse
from srsinv.forward.feature import Feature
from srsinv.forward.noise import Noise
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
    RankedPressure,
    RankedSamples,
    TimedScan,
)
from .ranks import RankedMethod
from .recordings import (
    STAGE_M,
    RankedKernel,
    RankedPasses,
    RankedTheory,
    RankedTolerances,
    RankedUncertainFit,
)
from .rigs import RankedDirection, RankedFacts, RankedRig

BROKEN = "bands too narrow on purpose"
RANGES = "calibration_of_bands.ranges"


Makers = Iterator[tuple[str, Callable[[], RankedMethod]]]


def ranked_methods(cfg: config.Config) -> list[RankedMethod]:
    """The methods that `calibration_of_bands.methods` names, in any case; all for null. No models
    are built of the others.

    Raises `BadInput` for names of none, and refusals of the configuration's parts.
    """
    names = cfg["calibration_of_bands"]["methods"]
    refuse(
        not isinstance(names, list | None),
        f"calibration_of_bands.methods is {echo(names)}: give a list of labels, or null for all.",
    )
    makers = {label.lower(): maker for label, maker in _methods(cfg)}
    asked = list(makers) if names is None else [str(each).lower() for each in names]
    unknown = [each for each in asked if each not in makers]
    refuse(
        bool(unknown) or not asked,
        f"calibration_of_bands.methods names {', '.join(unknown) or 'none'}: give some of "
        f"{', '.join(map(repr, makers))}.",
    )
    return [makers[each]() for each in asked]


def _methods(cfg: config.Config) -> Makers:
    """The label of each method, and what makes it by the configuration's sensor, scan, noise and
    grid. Settings are checked here, and models are built when a method is made."""
    settings = cfg["calibration_of_bands"]
    sensor, scan, noises = config.sensor(cfg), config.scan(cfg), config.noises(cfg)
    scan.require_onwards()
    refuse(
        len(sensor.elements) != 2,
        f"The sensor has {len(sensor.elements)} elements, but p and q are tested with two: give "
        "sensor=two_element.",
    )
    spectrum, speed = prior_spectrum(cfg), float(scan.speed_m_per_s)
    yield from _of_line(cfg, sensor, scan, noises, spectrum)
    timed = TimedScan(sensor, speed, spectrum)
    yield RankedSamples.label, partial(RankedSamples, timed)
    yield RankedLive.label, partial(RankedLive, timed)
    for path in ("direct", "spectral"):
        label = f"LinearProblem, {path}"
        yield label, partial(RankedLinear, label, path)
    yield from _features(cfg, settings, sensor, scan)
    yield RankedRig.label, partial(RankedRig, sensor, speed)
    yield RankedFacts.label, partial(RankedFacts, sensor, scan, spectrum)
    yield RankedDirection.label, partial(RankedDirection, sensor)
    yield RankedPitch.label, RankedPitch
    for label, is_sampled in (("srsinv.fit", False), ("srsinv.sample (NUTS)", True)):
        yield label, partial(RankedFit, label, is_sampled, is_quick=not is_sampled)
    yield from _recordings(sensor, scan, spectrum)


def _of_line(
    cfg: config.Config,
    sensor: Sensor,
    scan: ConstantSpeed,
    noises: tuple[Noise, ...],
    spectrum: Exponential,
) -> Makers:
    """Inversions of scans along the configuration's line, all of them and open ones."""
    line, inversions = config.line(cfg), config.methods(cfg)
    start = float(line.start_m)
    whole_line = Periodic(line.n, float(line.cell_m), start)
    # Of an open scan the direct path solves at most some hundred cells in no time.
    open_line = Open(line.n // 2, 2 * float(line.cell_m), start)

    of = sensor, scan, noises, spectrum
    on_whole = cache(partial(DrawnScan.of, whole_line, *of))
    on_open = cache(partial(DrawnScan.of, open_line, *of))
    for name, method in inversions.items():
        yield name, lambda n=name, m=method: RankedInversion(n, m, on_whole())
    for name, method in inversions.items():
        label = f"{name}, open with gaps"
        yield (
            label,
            lambda n=label, m=method: RankedInversion(
                n, m, on_open(), is_quick=not m.chooses_prior
            ),
        )
    name, method = next(iter(inversions.items()))
    broken = cfg["calibration_of_bands"]["broken"]
    factor = number("calibration_of_bands.broken", broken, "a positive factor", above=0)
    label = f"{name}, {BROKEN}"
    yield label, lambda n=label, m=method: RankedInversion(n, m, on_whole(), too_narrow=factor)
    yield RankedAdmissible.label, lambda: RankedAdmissible(on_whole(), spectrum)
    yield RankedPressure.label, lambda: RankedPressure(on_whole(), spectrum)


PASSES, SHIFTED_PASSES = 4, 8


def _recordings(sensor: Sensor, scan: ConstantSpeed, spectrum: Exponential) -> Makers:
    """Recordings of several passes, of a rig known to its tolerances, and with a kernel that was
    measured."""
    once, to_and_fro, off = (
        TimedScan(sensor, float(scan.speed_m_per_s), spectrum, passes)
        for passes in (1, PASSES, SHIFTED_PASSES)
    )
    for label, on, stage_m, is_estimated in (
        ("Passes to and fro", to_and_fro, 0.0, False),
        ("Passes to and fro, noise estimated", to_and_fro, 0.0, True),
        ("Passes of a stage that is off", off, STAGE_M, False),
    ):
        yield label, partial(RankedPasses, label, on, stage_m, is_estimated)
    yield RankedTolerances.label, partial(RankedTolerances, once)
    yield RankedUncertainFit.label, partial(RankedUncertainFit, once)
    yield RankedKernel.label, partial(RankedKernel, sensor, scan, spectrum)
    yield RankedTheory.label, partial(RankedTheory, sensor, scan)


def prior_spectrum(cfg: config.Config) -> Exponential:
    """The spectrum of p and of q from which tractions are drawn."""
    key, given = "calibration_of_bands.prior", cfg["calibration_of_bands"]["prior"]
    given, wanted = mapping(key, given), "a positive number"
    names = "rms_Pa", "correlation_m"
    return Exponential(*(number(f"{key}.{each}", given[each], wanted, above=0) for each in names))


def _features(
    cfg: config.Config, settings: Mapping[str, Any], sensor: Sensor, scan: ConstantSpeed
) -> Makers:
    """Fits of the features that ranges are given of, and of the scene's shape."""
    solver, line = config.solver(cfg), config.line(cfg)
    given, above_0 = mapping(RANGES, settings["ranges"]), "a positive number"
    rate = number("calibration_of_bands.sample_rate_hz", settings["sample_rate_hz"],
                  f"{above_0} in Hz", above=0)  # fmt: skip
    sampled = SampledScan("calibration_of_bands", rate, sensor, scan, config.noises(cfg))

    def fit_of_load(name: str, feature: Feature, ranges: Ranges, label: str) -> RankedLoad:
        on = SyntheticScan.along(line, sampled)
        fitter = FeatureFitter.along(sensor, on.motion, solver)
        return RankedLoad(label, KnownLoad(on, name, ranges.middle, feature, fitter), ranges)

    for name, feature in config.features(cfg).items():
        parts = [*feature.axes, feature.amplitude, "friction"]
        ranges = _ranges(given, name, parts)
        refuse(
            len(ranges.of) < len(parts),
            f"{RANGES}.{name} has no {listed(set(parts) - set(ranges.of))}: give a range of each.",
        )
        label = f"Fit of {name.replace('_', ' ')}"
        yield label, partial(fit_of_load, name, feature, ranges, label)
    names = list(config.part(cfg, "scene").get("surfaces") or ())
    if not names:
        return
    shape = SceneShape.of(config.scene(cfg), names, {})
    part = number("calibration_of_bands.surface_window", settings["surface_window"],
                  above_0, above=0)  # fmt: skip
    half = line.n * float(line.cell_m) / 2 * part
    ranges = _ranges(given, shape.name, list(shape.truth))
    label = f"Fit of a {shape.name.replace('_', ' ')}"

    def fit_of_surface() -> RankedSurface:
        known = KnownShape.in_window(shape, sampled, Window(-half, half), solver)
        return RankedSurface(label, known, ranges)

    yield label, fit_of_surface


def _ranges(given: Mapping[str, Any], name: str, parameters: Sequence[str]) -> Ranges:
    """Those of a feature's parameters."""
    refuse(name not in given, f"{RANGES} has no {name}: give the ranges of its parameters.")
    return Ranges.checked(f"{RANGES}.{name}", given[name], parameters)
