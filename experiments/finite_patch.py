"""A finger that touches over a finite zone, against one that touches the whole surface."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray
from jaxtyping import Float
from matplotlib.figure import Figure

from srsinv import config, plot
from srsinv.compiled import compiled
from srsinv.errors import number, number_range, whole
from srsinv.forward.envelope import Envelope, FingerprintRidges, FoundationPatch, HertzPatch
from srsinv.forward.sensor import FilmSignal, Sensor
from srsinv.forward.simulation import Simulation
from srsinv.grid import as_real
from srsinv.report.data import dataset, scalars
from srsinv.report.plot.style import TRUTH, colours
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import significant

ZONES = {"foundation": FoundationPatch, "hertz": HertzPatch}
INFINITE, RIDGED = "infinite", "foundation with ridges"
P, Q = colours("pq").values()
LOOKS = {
    INFINITE: {"color": TRUTH, "linestyle": "--"},
    "foundation": {"color": P},
    "hertz": {"color": Q, "linestyle": "-."},
    RIDGED: {"color": P},
}
NARROW = 1e-3  # of the depth: the cell that stands for a line load
REACH = 1.25  # of the half-width, over which kernels are drawn
WAVES_M = np.geomspace(1e-4, 2e-2, 241)


def run(cfg: config.Config) -> Result:
    """The change of the scene's signal by zones of either profile and of many half-widths; kernels
    and signals at one; and the response to pressure with ridges on the finger.

    Raises `BadInput` for lengths that are not positive, and refusals of the configuration's parts.
    """
    given = cfg["finite_patch"]
    wanted = "half-widths over the depth"
    ends = number_range("finite_patch.half_widths", given["half_widths"], wanted, above=0)
    points = whole("finite_patch.points", given["points"], "a whole number from 2", least=2)
    wanted = "a positive length in metres"
    half = number("finite_patch.half_width_m", given["half_width_m"], wanted, above=0)
    relative = np.geomspace(*ends, points)
    with config.precision(cfg):
        sim = config.simulation(cfg)
        depth, ideal = float(sim.sensor.depth_m), np.asarray(sim.signal())
        changes = [
            [_change(sim, zone(each * depth), ideal) for each in relative]
            for zone in ZONES.values()
        ]
        ridges = FingerprintRidges(given["modulation"], given["pitch_m"])
        envelopes = {INFINITE: (), **{name: (zone(half),) for name, zone in ZONES.items()}}
        envelopes[RIDGED] = (ZONES["foundation"](half), ridges)
        sensors = {name: _pressing(sim.sensor, own) for name, own in envelopes.items()}
        x = np.linspace(-REACH * half, REACH * half, 801)
        kernels = [_kernels(sensor, x) for sensor in sensors.values()]
        signals = [np.asarray(_with(sim, sensor).signal()) for sensor in sensors.values()]
        responses = [_response(sensor, sim) for sensor in sensors.values()]
    data = _dataset(sim, relative, np.array(changes), x, np.stack(kernels), np.stack(signals),
                    np.stack(responses), given, list(sensors))  # fmt: skip
    shown = sections(__file__, kernels=draw_kernels, signals=draw_signals)
    return Result(_title(data), data, shown)


def _pressing(sensor: Sensor, envelopes: tuple[Envelope, ...]) -> Sensor:
    for each in envelopes:
        sensor = sensor.with_envelope(each)
    return sensor


def _with(sim: Simulation, sensor: Sensor) -> Simulation:
    scenario = sim.scenario.replace(sensor=sensor)
    return Simulation(scenario, sim.line, sim.fine, sim.refinement)


def _change(sim: Simulation, zone: Envelope, ideal: Float[np.ndarray, "e n"]) -> float:
    """Rms change of the signal by a zone, over the signal's rms without it."""
    signal = np.asarray(_with(sim, sim.sensor.with_envelope(zone)).signal())
    return float(np.linalg.norm(signal - ideal) / np.linalg.norm(ideal))


def _kernels(sensor: Sensor, x: Float[np.ndarray, " x"]) -> Float[np.ndarray, "2 x"]:
    """The first element's charge under unit line loads of p and q, x before it [C m/N]."""
    cell = NARROW * float(sensor.depth_m)
    return np.asarray(_cell_response(sensor.charge(), as_real(x), as_real(cell)))[0] / cell


def _response(sensor: Sensor, sim: Simulation) -> Float[np.ndarray, " wave"]:
    """The first element's signal per pressure, over wavelengths."""
    k = jnp.asarray(2 * np.pi / WAVES_M)
    return np.abs(np.asarray(_transfer(sensor.output(sim.scan), k))[0, 0])


@compiled
def _cell_response(stage: FilmSignal, x: Any, cell_m: Any):
    return stage.cell_response(x, cell_m)


@compiled
def _transfer(stage: FilmSignal, k: Any):
    return stage.transfer(k)


def _dataset(sim: Simulation, relative, changes, x, kernels, signals, responses,
             given: Mapping[str, Any], fingers: list[str]) -> xarray.Dataset:  # fmt: skip
    """Changes (profile, half-width); kernels (finger, component, lag); signals (finger, element, x)
    and responses (finger, wavelength)."""
    gain = responses[fingers.index(RIDGED)] / responses[fingers.index("foundation")]
    unit = sim.sensor.amplifier.unit
    of_pitch = np.argmin(np.abs(WAVES_M - float(given["pitch_m"])))
    rms = np.linalg.norm(signals - signals[:1], axis=(1, 2)) / np.linalg.norm(signals[0])
    label = "change_{profile}_at_{relative_half_width}_depths"
    return dataset(
        {
            "change": (("profile", "relative_half_width"), changes, "1", label),
            "kernel": (("finger", "component", "lag"), kernels, "C m/N"),
            "signal": (("finger", "element", "x"), signals, unit),
            "signal_change": ("finger", rms, "1", "signal_change_{finger}"),
            "response": (("finger", "wavelength"), responses, f"{unit}/Pa"),
            "ridge_gain": ("wavelength", gain, "1"),
            **scalars({
                "ridge_gain_at_pitch": gain[of_pitch],
                "ridge_gain_at_5_mm": float(np.interp(5e-3, WAVES_M, gain)),
            }),
        },
        {
            "profile": (list(ZONES), "1"),
            "relative_half_width": (np.round(relative, 6), "1"),
            "finger": (fingers, "1"),
            "component": (["p", "q"], "1"),
            "lag": (x, "m"),
            "element": (sim.sensor.element_names, "1"),
            "x": (np.asarray(sim.line.x), "m"),
            "wavelength": (WAVES_M, "m"),
        },
        half_width_m=float(given["half_width_m"]), depth_m=float(sim.sensor.depth_m),
        modulation=float(given["modulation"]), pitch_m=float(given["pitch_m"]),
        speed_m_per_s=float(sim.scan.speed_m_per_s), line=sim.line.kind,
    )  # fmt: skip


def _title(data: xarray.Dataset) -> str:
    change = 100 * float(data["signal_change"].sel(finger="foundation"))
    half = 1e3 * data.attrs["half_width_m"]
    return (
        f"A contact zone of {half:.3g} mm half-width changes the signal by "
        f"{significant(change, 3)} %"
    )


def draw_kernels(ds: xarray.Dataset) -> Figure:
    """Kernels of p and q by a finger of each profile."""
    names = [INFINITE, *ZONES]
    return plot.panels([
        plot.panel(
            {each: ds["kernel"].sel(component=name, finger=each) for each in names}, looks=LOOKS,
            along="position of the film from the load", title=f"Line load of {name}",
            quantity="charge per load",
        )
        for name in ("p", "q")
    ])  # fmt: skip


def draw_signals(ds: xarray.Dataset) -> Figure:
    """The first element's signal, what a zone of each profile changes, and that with ridges."""
    first = ds["signal"].isel(element=0)
    infinite = first.sel(finger=INFINITE)
    changed = {name: first.sel(finger=name) - infinite for name in ZONES}
    for each in changed.values():
        each.attrs = first.attrs
    reach = REACH * ds.attrs["half_width_m"]
    parts = {
        "Touching everywhere, and in a zone": {n: first.sel(finger=n) for n in (INFINITE, *ZONES)},
        "Change by the zone": changed,
        "With ridges on the finger": {RIDGED: first.sel(finger=RIDGED)},
    }
    return plot.panels([
        plot.panel(lines, looks=LOOKS, quantity="signal", along="position", title=title,
                   within=(-reach, reach))
        for title, lines in parts.items()
    ])  # fmt: skip
