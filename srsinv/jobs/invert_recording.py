"""Invert a recorded signal: p and q by every method named, with bands, and what cannot be seen."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..errors import refuse
from ..forward.describe import elements
from ..forward.film import SampleAverage
from ..forward.noise import SignalToNoise, total_spectrum
from ..forward.scan import ConstantSpeed
from ..forward.sensor import Sensor
from ..grid import Open
from ..inverse.problem import Problem
from ..inverse.quadratic import DIRECT_LIMIT
from ..recording import Recording, load, merge
from ..report.outcome import Outcome
from . import build
from .analysis import Case
from .analysis import run as analyse

CELLS_PER_DEPTH = 8  # e^(-k z) leaves nothing beyond: at the cells' last wavenumber it is e^(-25)
MARGIN_DEPTHS = 8  # how far beyond the scan's ends the traction can still be felt
STEADY = 1e-3  # how far a speed may stray from its mean and still be taken as constant
JITTER = 0.2  # of the sampling interval: beyond it there is a gap
ROUNDED = 0.25  # of an interval: time stamps nearer to even ones than this are only rounded
ABOVE_CUTOFF = 12.0  # k z beyond which e^(-k z) < 1e-5: noise only


def run(cfg: build.Config) -> Outcome:
    """The job: load, put on a line of cells, invert, report."""
    with build.precision(cfg):
        recording = _load(cfg)
        facts = recording.sidecar
        description = merge(facts.get("sensor", {}), cfg["sensor"])
        ideal = elements(description, cfg["effects"])
        depth = min(float(film.depth_m) for film in ideal)
        speed = float(np.mean(recording.speed_m_per_s))
        spacing = abs(speed) / recording.sample_rate_hz
        unknowns = 1 if cfg["friction"] is not None else 2
        block = _block(cfg, recording, depth, spacing, unknowns)
        noise_rms = _white_rms(cfg, recording, depth, spacing)
        line, data, observed = _on_line(recording.block_average(block), cfg, facts, depth)
        average = (SampleAverage(block, spacing),) if block > 1 else ()
        sensor = Sensor(
            elements(description, cfg["effects"], average),
            skin=build.make(merge({"poisson_ratio": 0.5} | _skin(facts), cfg["skin"])),
            amplifier=build.amplifier(_amplifier(cfg, description)),
        )
        refuse(
            len(sensor.elements) != data.shape[0],
            f"{recording.name}: {data.shape[0]} signal columns but {len(sensor.elements)} film "
            "elements: name as many in recording.channels as the sensor has elements.",
        )
        scan = ConstantSpeed(speed)
        noise = _spectrum(cfg, line, scan, data, observed, noise_rms / np.sqrt(block))
        offset = sensor.amplifier.offset
        if offset is None:
            noise = noise.at[0].set(jnp.inf)
        else:
            data = jnp.where(observed, data - offset, 0.0)
        nominal = facts.get("nominal_pressure_Pa")
        problem = Problem(
            line,
            line.operator(sensor.signal(scan)),
            data,
            noise,
            observed=observed,
            known_mean_Pa=(0.0, None),
            background_Pa=(nominal, None),
            friction=cfg["friction"],
        )
        case = Case(
            title=f"{recording.name}: {', '.join(cfg['method'])}",
            problem=problem,
            sensor=sensor,
            speed_m_per_s=speed,
            methods=build.methods(cfg),
            signal_unit=recording.signal_unit,
            assumed=_assumed(cfg, recording, sensor, line, block, spacing, noise_rms, nominal),
            time_steady=False,
        )
        return analyse(case)


def _load(cfg: build.Config) -> Recording:
    settings = dict(cfg["recording"])
    path, missing = settings.pop("path"), settings.pop("missing", "refuse")
    refuse(path is None, "No recording is named: give recording.path=FILE.")
    settings.pop("cell_m", None)
    named = cfg["sensor"]["elements"]
    listed = list(named.values()) if isinstance(named, dict) else named
    known = settings | {"sensor": {"elements": listed}}
    recording = load(path, missing=missing, **_given(known))
    refuse(
        not recording.is_constant_speed(STEADY),
        f"{recording.name}: the speed varies by more than {STEADY:.1%} of its mean, and this "
        "inversion takes it as constant: give recording.speed_m_per_s=... to do so all the same.",
    )
    refuse(
        float(np.mean(recording.speed_m_per_s)) == 0.0,
        f"{recording.name}: the speed is 0, so no surface passes the sensor: give "
        "recording.speed_m_per_s=... in m/s.",
    )
    jitter = recording.sampling_jitter
    refuse(
        jitter > JITTER,
        f"{recording.name}: the sampling interval varies by {jitter:.0%}, more than {JITTER:.0%}: "
        "give recording.sample_rate_hz=... or cut the recording at the gap.",
    )
    return _uniform(recording)


def _uniform(recording: Recording) -> Recording:
    """The recording at even times.

    Stamps that are off by less than a quarter of an interval are only rounded, and are replaced:
    interpolating would colour the noise, which the rules take as white. Else the signal is
    interpolated.
    """
    time_s = recording.time_s
    even = np.linspace(time_s[0], time_s[-1], time_s.size)
    if np.max(np.abs(time_s - even)) < ROUNDED / recording.sample_rate_hz:
        return replace(recording, time_s=even)
    return recording.resample_uniform()


def _given(known: dict[str, Any]) -> dict[str, Any]:
    """What the command line gives, in depth: null means not given."""
    trimmed = {k: _given(v) if isinstance(v, dict) else v for k, v in known.items()}
    return {k: v for k, v in trimmed.items() if v is not None and v != {}}


def _skin(facts: dict[str, Any]) -> dict[str, Any]:
    skin = facts.get("skin", {})
    model = skin.get("model", "half_space")
    refuse(
        model != "half_space",
        f"The sidecar's skin.model is {model!r}: only half_space is known here.",
    )
    return {"poisson_ratio": skin["poisson_ratio"]} if "poisson_ratio" in skin else {}


def _amplifier(cfg: build.Config, description: dict[str, Any]) -> dict[str, Any]:
    resistance = description.get("feedback_resistance_ohm")
    node = dict(cfg["amplifier"])
    if node.get("feedback_resistance_ohm", 0) is None:
        node["feedback_resistance_ohm"] = resistance
    return {"amplifier": node}


def _block(
    cfg: build.Config, recording: Recording, depth: float, spacing: float, unknowns: int
) -> int:
    """How many samples are averaged into one cell."""
    wanted = cfg["recording"].get("cell_m")
    refuse(
        wanted is not None and not wanted > 0,
        f"recording.cell_m is {wanted}: give a positive width in metres.",
    )
    length = spacing * recording.time_s.size + 2 * MARGIN_DEPTHS * depth
    least = length * unknowns / DIRECT_LIMIT if wanted is None else 0.0
    cell = max(depth / CELLS_PER_DEPTH, least) if wanted is None else wanted
    return int(np.clip(round(cell / spacing), 1, recording.time_s.size // 3))


def _on_line(recording: Recording, cfg: build.Config, facts: dict[str, Any], depth: float):
    """The open line over the contact window, the signal on its cells, and where there is one."""
    x, signal = recording.position_m, recording.signal
    if x[-1] < x[0]:
        x, signal = x[::-1], signal[:, ::-1]
    cell = (x[-1] - x[0]) / (x.size - 1)
    margin = MARGIN_DEPTHS * depth
    window = facts.get("contact_window_m") or [x[0] - margin, x[-1] + margin]
    before = max(0, int(np.floor((x[0] - cell / 2 - window[0]) / cell)))
    after = max(0, int(np.floor((window[1] - x[-1] - cell / 2) / cell)))
    line = Open(before + x.size + after, cell, x[0] - before * cell)
    padded = np.pad(signal, ((0, 0), (before, after)), constant_values=np.nan)
    observed = np.isfinite(padded)
    return line, jnp.asarray(np.where(observed, padded, 0.0)), observed


def _white_rms(cfg: build.Config, recording: Recording, depth: float, spacing: float) -> float:
    """The white noise per sample: given, or the level where the skin lets nothing through.

    The median of the periodogram over the upper wavenumbers, which a few lines do not move.
    """
    white = cfg["noise"].get("white")
    if white is not None and white["rms"] is not None:
        return float(white["rms"])
    signal = np.nan_to_num(recording.signal)
    n = signal.shape[-1]
    taper = np.hanning(n)
    slope = np.linspace(-1, 1, n)
    left = signal - signal.mean(axis=-1, keepdims=True)
    left = left - (left @ slope / (slope @ slope))[:, None] * slope
    power = np.abs(np.fft.rfft(left * taper)) ** 2 / np.sum(taper**2)
    k = 2 * np.pi * np.fft.rfftfreq(n, spacing)
    noise_only = k > min(ABOVE_CUTOFF / depth, 0.75 * k[-1])
    level = np.median(power[:, noise_only]) / np.log(2)
    refuse(
        not level > 0,
        f"{recording.name}: no noise can be told from the signal (it is constant, or rounded): "
        "give noise.white.rms=... in the signal's unit.",
    )
    return float(np.sqrt(level))


def _spectrum(cfg, line, scan, data, observed, white_rms: float):
    """Noise power per block; white noise is what the recording shows, other causes as named."""
    others = {name: node for name, node in cfg["noise"].items() if name != "white"}
    noises = tuple(build.make(node) for node in others.values())
    for noise in noises:
        refuse(
            isinstance(noise, SignalToNoise),
            "noise=snr has no meaning for a recording: use noise=white (noise.white.rms, or null "
            "to take it from the recording).",
        )
    signal_rms = jnp.sqrt(jnp.sum(data**2) / np.sum(observed))
    return total_spectrum(noises, line, scan, signal_rms) + white_rms**2


def _assumed(cfg, recording, sensor, line, block, spacing, noise_rms, nominal):
    unit = recording.signal_unit
    off = [name for name in build.EFFECTS if name not in cfg["effects"]]
    return (
        ("recording", f"{recording.name}, {recording.time_s.size} samples {1e6 * spacing:.4g} um "
         f"apart"),
        ("cells", f"{line.n} of {1e6 * float(line.cell_m):.4g} um, each with the mean of {block} "
         "samples (as the model has it, too)"),
        ("line", "open: p and q are deviations from a uniform background, zero outside the window"),
        ("window", f"{1e3 * float(line.x[0]):.4g} to {1e3 * float(line.x[-1]):.4g} mm; beyond the "
         "scan's ends the traction is estimated from what can still be felt there"),
        ("nominal pressure", "not known" if nominal is None else f"{nominal:.4g} Pa"),
        ("skin", f"half space, Poisson's ratio {float(sensor.skin.poisson_ratio):.4g}"),
        ("amplifier", type(sensor.amplifier).__name__),
        ("noise", f"white, {noise_rms:.3g} {unit} per sample, "
         + ("given" if (cfg["noise"].get("white") or {}).get("rms") is not None
            else "from the highest wavenumbers of the recording")),
        ("effects on", ", ".join(cfg["effects"]) or "none"),
        ("effects off", ", ".join(off) or "none"),
        ("p and q", "apart" if cfg["friction"] is None else f"q = {cfg['friction']} p"),
    )  # fmt: skip
