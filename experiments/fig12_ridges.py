"""The paper's Fig. 12: ridges 6.5 um high, their signal and noise, and detection by averaging."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray

from srsinv import config
from srsinv.effects import add_effects
from srsinv.errors import BadInput, number, refuse, whole
from srsinv.forward.film import Film
from srsinv.forward.noise import Noise, with_noise
from srsinv.forward.operator import PositionInterpolation
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import Scene, SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface import Ridges
from srsinv.grid import Line, Periodic
from srsinv.inverse import detection, spectral_lines
from srsinv.report.figures import ridges as figures
from srsinv.report.outcome import Outcome, Section, Table
from srsinv.report.text import listed

PAPER_M = {"6.5 um": 6.5e-6, "0.65 um": 0.65e-6}  # measured; and expected to be measurable
SAMPLES_PER_RIDGE = 20  # samples of a ridge; their means hold all but 0.4 % of its wave
OVERSAMPLING = 4  # of the spectrum
CONTACT_LOADS = (0.8, 0.95)  # of the closed form's, where the gap between ridges is evaluated


@dataclass(frozen=True)
class RidgeSettings:
    """`fig12_ridges` of the configuration.

    The scan: samples per second and ridges slid over. Its analysis: where the pitch is looked for,
    the probabilities of detection, the height of a distinct peak in rms of noise, and the most
    ridges averaged over. What is tried: heights, pressures, and the width of a strip for contrast.
    """

    sample_rate_hz: float
    ridges: int
    pitch_range_m: Sequence[float]
    false_alarm: float
    detection: float
    peak_over_noise: float
    most_ridges: float
    heights_m: np.ndarray
    pressures_Pa: np.ndarray
    blind_strip_width_m: float

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> "RidgeSettings":
        """Those given; raises `BadInput` for too few ridges or heights, and what is not positive.
        The rate is checked against the scan."""
        wanted = "a whole number from 5"
        return cls(
            sample_rate_hz=given["sample_rate_hz"],
            ridges=whole("fig12_ridges.ridges", given["ridges"], wanted, least=5),
            pitch_range_m=given["pitch_range_m"],
            false_alarm=given["false_alarm"],
            detection=given["detection"],
            peak_over_noise=given["peak_over_noise"],
            most_ridges=given["most_ridges"],
            heights_m=_range(given),
            pressures_Pa=_pressures(given["pressures_Pa"]),
            blind_strip_width_m=given["blind_strip_width_m"],
        )

    @property
    def strength(self) -> float:
        """The d' that a wave needs; raises `BadInput` for probabilities that are none."""
        return detection.needed_wave(self.false_alarm, self.detection)


class RidgeScan(NamedTuple):
    """Scan of a sensor over ridges, on a line of whole pitches."""

    line: Line
    scene: SurfaceScene
    ridges: Ridges
    sensor: Sensor
    scan: ConstantSpeed

    @property
    def pitch_m(self) -> float:
        return float(self.ridges.pitch_m)


class PitchWaves(NamedTuple):
    """For each point, the amplitude (point, 2) [V] of the wave at the pitch, of the sensor's film
    and of the wide one; pressure and gap (point, n); and whether all converged."""

    size: np.ndarray
    pressure: np.ndarray
    gap: np.ndarray
    converged: bool


class Simulated(NamedTuple):
    """Simulated signals of the ridges.

    At the samples `x` (sample,): `signal`, `data` with noise [V], and the noise's power `spectrum`;
    `per_ridge` of them lie on a pitch. Amplitude [V] of the wave at the pitch: of the scene's film
    and of the `blind` wide one, `by_height` over `heights` [m] and `by_pressure` over `pressures`
    [Pa]. Load [N/m] of a ridge at which the skin reaches the plate: by contact, and by the closed
    form.
    """

    x: np.ndarray
    signal: np.ndarray
    spectrum: np.ndarray
    data: np.ndarray
    per_ridge: float
    heights: np.ndarray
    by_height: np.ndarray
    pressures: np.ndarray
    by_pressure: np.ndarray
    amplitude: float
    blind: float
    load: float
    load_closed: float
    waves: PitchWaves


class Limits(NamedTuple):
    """White noise as strong as at the pitch, `level` [V], and the limits in it: the `needed` d',
    and the `least_height` [m] detected over `counts` of ridges."""

    level: float
    needed: float
    counts: np.ndarray
    least_height: np.ndarray


def run(cfg: config.Config) -> Outcome:
    """The pitch from a noisy signal, and the signal's amplitude against the paper's statements.

    Raises `BadInput` for another surface than ridges, a window that does not hold whole pitches,
    and more than one film element.
    """
    settings = RidgeSettings.checked(cfg["fig12_ridges"])
    needed = settings.strength
    with config.precision(cfg):
        setup = _setup(config.line(cfg), config.scene(cfg), config.sensor(cfg), config.scan(cfg))
        blind = partial(dataclasses.replace, width_m=settings.blind_strip_width_m)
        without = config.ideal(cfg).with_films(blind)
        wide = add_effects(without, config.sensor_effects(cfg)).sensor.elements[0]
        simulated = _simulated(settings, setup, wide, config.noises(cfg), config.random_key(cfg))
    limits = _limits(settings, setup, simulated, needed)
    metrics = _metrics(settings, setup, simulated, limits)
    dataset = _dataset(settings, setup, simulated, limits)
    height = 1e6 * float(setup.ridges.height_m)
    rest = (
        f"noise {', '.join(cfg['noise'])}, nothing of the amplifier's own; seed {cfg['seed']}. "
        f"Effects on: {listed(cfg['effects'])}."
    )
    return Outcome(
        f"Ridges {height:.3g} µm high on a pitch of {1e3 * setup.pitch_m:.3g} mm",
        metrics,
        dataset,
        _sections(dataset, metrics, settings, setup, rest),
        _summary(metrics, settings),
    )


def _simulated(
    settings: RidgeSettings, setup: RidgeScan, wide: Film, noises: tuple[Noise, ...], key
) -> Simulated:
    samples = _samples(settings, setup)
    heights, pressures = settings.heights_m, settings.pressures_Pa
    nominal, height = setup.scene.nominal_pressure_Pa, setup.ridges.height_m
    load_closed = _closed_form_load(setup)
    loads = load_closed * np.asarray(CONTACT_LOADS)
    waves = _solve_pitch_waves(setup, wide, [
        *((each, nominal) for each in heights),
        *((height, each) for each in pressures),
        *((height, each / setup.pitch_m) for each in loads),
        (height, nominal),
    ])  # fmt: skip
    signal, spectrum, data = _signals(setup, samples, noises, waves, key)
    by_height, by_pressure = np.split(waves.size[: -1 - loads.size, 0], [heights.size])
    amplitude, blind = waves.size[-1]
    return Simulated(
        x=np.asarray(samples.x),
        signal=signal,
        spectrum=spectrum,
        data=data,
        per_ridge=settings.sample_rate_hz * setup.pitch_m / float(setup.scan.speed_m_per_s),
        heights=heights,
        by_height=by_height,
        pressures=pressures,
        by_pressure=by_pressure,
        amplitude=amplitude,
        blind=blind,
        load=_load_between(setup, loads, waves.gap[-1 - loads.size : -1]),
        load_closed=load_closed,
        waves=waves,
    )


def _limits(
    settings: RidgeSettings, setup: RidgeScan, simulated: Simulated, needed: float
) -> Limits:
    k = np.fft.rfftfreq(simulated.x.size, simulated.x[1] - simulated.x[0])
    level = np.sqrt(np.interp(1 / setup.pitch_m, k, simulated.spectrum))
    counts = np.geomspace(1, settings.most_ridges, 121)
    least_amplitude = needed * level * np.sqrt(2 / (counts * simulated.per_ridge))
    least_height = _inverse(least_amplitude, simulated.by_height, simulated.heights)
    return Limits(level, needed, counts, least_height)


def _metrics(
    settings: RidgeSettings, setup: RidgeScan, simulated: Simulated, limits: Limits
) -> dict[str, Any]:
    pitch, level, amplitude = setup.pitch_m, limits.level, simulated.amplitude
    fitted = _pitch(simulated.x, simulated.data, simulated.per_ridge, settings.pitch_range_m)
    tone_hz = float(setup.scan.speed_m_per_s) / pitch
    noise = np.sqrt(np.mean(simulated.spectrum))
    in_band = level * np.sqrt(4 * tone_hz / settings.sample_rate_hz)
    strength = amplitude / np.sqrt(2) / level  # d' is this times the root of the samples
    span = np.ptp(simulated.x) * simulated.x.size**0.5
    metrics = {
        "pitch_m": fitted.pitch_m,
        "pitch_m_stderr": fitted.stderr_m,
        "pitch_m_stderr_bound": np.sqrt(6) * pitch**2 * level / (np.pi * amplitude * span),
        "pitch_error": fitted.pitch_m / pitch - 1,
        "amplitude_V": amplitude,
        "amplitude_blind_strip_V": simulated.blind,
        "amplitude_most_V": simulated.by_pressure.max(),
        "amplitude_most_at_Pa": simulated.pressures[simulated.by_pressure.argmax()],
        "noise_rms_V": noise,
        "noise_rms_in_band_V": in_band,
        "band_hz": 2 * tone_hz,
        "snr_per_sample": amplitude / np.sqrt(2) / noise,
        "snr_in_band": amplitude / np.sqrt(2) / in_band,
        "strength_over_scan": strength * np.sqrt(simulated.x.size),
        "strength_needed": limits.needed,
        "snr_shortfall": settings.peak_over_noise * noise / amplitude,
        "snr_shortfall_in_band": settings.peak_over_noise * in_band / amplitude,
        "least_height_over_scan_m": np.interp(settings.ridges, limits.counts, limits.least_height),
    }
    for name, height in PAPER_M.items():
        size = np.interp(height, simulated.heights, simulated.by_height)
        length = pitch / simulated.per_ridge * 2 * (limits.needed * level / size) ** 2
        metrics[f"averaging_length_{name.replace(' ', '')}_m"] = length
    metrics |= {
        "load_to_touch_between_N_per_m": simulated.load,
        "load_to_touch_between_closed_form_N_per_m": simulated.load_closed,
        "load_per_ridge_N_per_m": float(setup.scene.nominal_pressure_Pa) * pitch,
    }
    known = {name: float(value) for name, value in metrics.items()}
    return known | {"contact_converged": simulated.waves.converged}


def _dataset(
    settings: RidgeSettings, setup: RidgeScan, simulated: Simulated, limits: Limits
) -> xarray.Dataset:
    amplitude_spectrum = _detected_lines(
        simulated.x, simulated.data, simulated.spectrum, setup, settings.false_alarm
    )
    in_band, lengths = (
        _low_passed(simulated.data, 2 / simulated.per_ridge),
        limits.counts * setup.pitch_m,
    )
    return xarray.Dataset(
        {
            "height": ("x", np.asarray(setup.scene.surface.height(setup.line)), {"units": "m"}),
            "gap": ("x", simulated.waves.gap[-1], {"units": "m"}),
            "pressure": ("x", simulated.waves.pressure[-1], {"units": "Pa"}),
            "signal": ("position", simulated.signal, {"units": "V"}),
            "data": ("position", simulated.data, {"units": "V"}),
            "data_in_band": ("position", in_band, {"units": "V"}),
            "data_amplitude": ("frequency", amplitude_spectrum[1], {"units": "V"}),
            "amplitude_by_chance": ("frequency", amplitude_spectrum[2], {"units": "V"}),
            "amplitude_by_height": ("ridge_height", simulated.by_height, {"units": "V"}),
            "amplitude_by_pressure": ("nominal_pressure", simulated.by_pressure, {"units": "V"}),
            "least_height": ("averaging_length", limits.least_height, {"units": "m"}),
        },
        {
            "x": ("x", np.asarray(setup.line.x), {"units": "m"}),
            "position": ("position", simulated.x, {"units": "m"}),
            "frequency": ("frequency", amplitude_spectrum[0], {"units": "Hz"}),
            "ridge_height": ("ridge_height", simulated.heights, {"units": "m"}),
            "nominal_pressure": ("nominal_pressure", simulated.pressures, {"units": "Pa"}),
            "averaging_length": ("averaging_length", lengths, {"units": "m"}),
        },
    )


def _setup(line: Line, scene: Scene, sensor: Sensor, scan: ConstantSpeed) -> RidgeScan:
    surface = scene.contact_scene
    ridges = surface and surface.surface.only(Ridges)
    if surface is None or ridges is None:
        raise BadInput("The scene is not one set of ridges: use scene=ridges.")
    elements = len(sensor.elements)
    refuse(elements != 1, f"sensor has {elements} elements: give 1, use sensor=one_element.")
    pitches = line.n * float(line.cell_m) / float(ridges.pitch_m)
    refuse(
        not isinstance(line, Periodic) or abs(pitches - round(pitches)) > 1e-6 or pitches < 0.5,
        f"The window holds {pitches:.4g} pitches: give grid.line=periodic and as grid.length_m a "
        "whole number of pitches.",
    )
    speed = float(scan.speed_m_per_s)
    refuse(speed <= 0, f"scan.speed_m_per_s is {speed}: give a positive speed in m/s.")
    return RidgeScan(line, surface, ridges, sensor, scan)


def _range(given: Mapping[str, Any]) -> np.ndarray:
    name, wanted = "fig12_ridges.height_range_m", "[least, greatest], positive and increasing"
    low, high = given["height_range_m"]
    low = number(name, low, wanted, above=0)
    number(name, high, wanted, above=low)
    wanted = "a whole number from 3"
    return np.geomspace(low, high, whole("fig12_ridges.heights", given["heights"], wanted, least=3))


def _pressures(given: list) -> np.ndarray:
    wanted = "a list of positive pressures in Pa"
    refuse(not given, f"fig12_ridges.pressures_Pa is empty: give {wanted}.")
    return np.array([number("fig12_ridges.pressures_Pa", p, wanted, above=0) for p in given], float)


def _samples(settings: RidgeSettings, setup: RidgeScan) -> Periodic:
    """The samples' positions, over whole ridges."""
    speed = float(setup.scan.speed_m_per_s)
    rate = number(
        "fig12_ridges.sample_rate_hz",
        settings.sample_rate_hz,
        "a number in Hz that makes at least four samples for each ridge",
        least=4 * speed / setup.pitch_m,
    )
    return Periodic(round(settings.ridges * setup.pitch_m * rate / speed), speed / rate, 0.0)


def _signals(setup: RidgeScan, samples: Periodic, noises, waves: PitchWaves, key):
    """The signal at the samples, the noise's power at their wavenumbers, and the signal with
    noise."""
    field = setup.sensor.operator(setup.line, setup.scan)
    traction = _traction(setup, setup.scene, jnp.asarray(waves.pressure[-1]))
    signal = jax.jit(lambda t: PositionInterpolation(setup.line, samples.x)(field(t)))(traction)
    data, spectrum, _ = with_noise(noises, samples, setup.scan, signal, key)
    refuse(not bool(jnp.all(spectrum > 0)), "There is no noise: give noise=[johnson].")
    return np.asarray(signal[0]), np.asarray(spectrum), np.asarray(data[0])


def _traction(setup: RidgeScan, scene: SurfaceScene, pressure):
    friction = scene.friction(setup.line, setup.scan.direction)
    return jnp.stack([pressure, setup.scan.direction * friction * pressure])


def _solve_pitch_waves(setup: RidgeScan, wide: Film, points) -> PitchWaves:
    """Contact with ridges and waves at the pitch, for points (height, nominal pressure)."""
    both = Sensor((*setup.sensor.elements, wide), setup.sensor.skin, setup.sensor.amplifier)
    field = both.operator(setup.line, setup.scan)
    wave = round(setup.line.n * float(setup.line.cell_m) / setup.pitch_m)

    def one(given):
        scene = _changed(setup.scene, *given)
        contact = scene.contact(setup.line)
        signal = field(_traction(setup, scene, contact.pressure_Pa))
        size = 2 * jnp.abs(jnp.fft.rfft(signal)[:, wave]) / setup.line.n
        return size, contact.pressure_Pa, contact.gap_m, contact.converged

    press = jax.jit(lambda given: jax.lax.map(one, given))
    size, pressure, gap, right = (np.asarray(v) for v in press(jnp.asarray(points, float)))
    return PitchWaves(size, pressure, gap, bool(right.all()))


def _changed(scene: SurfaceScene, height, pressure) -> SurfaceScene:
    return eqx.tree_at(
        lambda s: (s.surface.shapes[0].height_m, s.nominal_pressure_Pa), scene, (height, pressure)
    )


def _closed_form_load(setup: RidgeScan) -> float:
    """Load per ridge [N/m] at which the skin reaches the plate between flat ridges: P = pi E* H /
    (2 arccosh(1/sin(pi a/L)))."""
    ridges, skin = setup.ridges, setup.scene.skin
    half = np.sin(np.pi * float(ridges.width_m) / 2 / setup.pitch_m)
    k = 2 * np.pi / setup.pitch_m
    plane = 2 / (k * float(np.abs(skin.compliance(jnp.asarray([k]))[0])))  # E* of a half space
    return float(np.pi * plane * float(ridges.height_m) / (2 * np.arccosh(1 / half)))


def _load_between(setup: RidgeScan, loads, gaps) -> float:
    """The load of `_closed_form_load` by contact: where the line through two gaps between ridges
    reaches zero."""
    from_ridge = np.asarray((setup.line.x - setup.ridges.position_m) % setup.pitch_m)
    between = gaps[:, np.abs(from_ridge - setup.pitch_m / 2).argmin()]
    slope = (between[1] - between[0]) / (loads[1] - loads[0])
    return float(loads[1] - between[1] / slope)


def _pitch(x, data, per_ridge: float, range_m) -> spectral_lines.Pitch:
    """The pitch from block means, with `SAMPLES_PER_RIDGE` of them for each ridge."""
    block = max(int(per_ridge / SAMPLES_PER_RIDGE), 1)
    n = x.size // block * block
    x, data = (each[:n].reshape(-1, block).mean(axis=1) for each in (x, data))
    return spectral_lines.scan_pitch(
        x, data[None], spectral_lines.drift(x, 2 * range_m[1]), tuple(range_m), 1
    )


def _detected_lines(x, data, spectrum, setup: RidgeScan, false_alarm: float):
    """Frequency [Hz] up to the fifth harmonic, amplitude [V] of the tapered data there, and the
    level that noise alone reaches anywhere in this band with probability `false_alarm`."""
    taper, bins, step = np.hanning(x.size), OVERSAMPLING * x.size, x[1] - x[0]
    per_m = np.fft.rfftfreq(bins, step)
    in_band = (per_m > 0.1 / setup.pitch_m) & (per_m <= 5.5 / setup.pitch_m)
    amplitude = 2 / taper.sum() * np.abs(np.fft.rfft(data * taper, bins)[in_band])
    power = np.interp(per_m[in_band], np.fft.rfftfreq(x.size, step), spectrum) * np.sum(taper**2)
    trials = x.size * step * np.ptp(per_m[in_band])  # independent waves; |.|^2 is exponential
    chance = 2 / taper.sum() * np.sqrt(power * np.log(trials / false_alarm))
    return abs(float(setup.scan.speed_m_per_s)) * per_m[in_band], amplitude, chance


def _low_passed(data, cycles_per_sample: float) -> np.ndarray:
    wave = np.fft.rfft(data)
    wave[np.fft.rfftfreq(data.size) > cycles_per_sample] = 0
    return np.fft.irfft(wave, data.size)


def _inverse(wanted, amplitudes, heights) -> np.ndarray:
    """The height of each amplitude; NaN where no height gives it."""
    rising = np.maximum.accumulate(amplitudes)
    log = np.interp(np.log(wanted), np.log(rising), np.log(heights), left=np.nan, right=np.nan)
    return np.exp(log)


def _summary(m, settings: RidgeSettings) -> Table:
    return Table(
        ("ridges", "value"),
        (
            ("pitch [mm]", 1e3 * m["pitch_m"]),
            ("its standard error [mm]", 1e3 * m["pitch_m_stderr"]),
            ("signal at the pitch, amplitude [µV]", 1e6 * m["amplitude_V"]),
            ("the same, strip as wide as the pitch [µV]", 1e6 * m["amplitude_blind_strip_V"]),
            ("noise, wide band, rms [µV]", 1e6 * m["noise_rms_V"]),
            (f"noise up to {m['band_hz']:.3g} Hz, rms [µV]", 1e6 * m["noise_rms_in_band_V"]),
            ("signal over noise, per sample", m["snr_per_sample"]),
            (f"d' over {settings.ridges} ridges", m["strength_over_scan"]),
            ("least height found over them [µm]", 1e6 * m["least_height_over_scan_m"]),
            ("averaging needed at 6.5 µm [mm]", 1e3 * m["averaging_length_6.5um_m"]),
            ("averaging needed at 0.65 µm [mm]", 1e3 * m["averaging_length_0.65um_m"]),
        ),
    )


def _sections(
    ds: xarray.Dataset, m, settings: RidgeSettings, setup: RidgeScan, rest: str
) -> tuple[Section, ...]:
    micro = {name: 1e6 * m[f"{name}_V"] for name in
             ("amplitude", "noise_rms", "noise_rms_in_band", "amplitude_blind_strip",
              "amplitude_most")}  # fmt: skip
    drawn = PAPER_M.values()
    return (
        Section(
            "Contact",
            ("The skin reaches the plate between ridges at "
             f"{m['load_to_touch_between_N_per_m']:.3g} "
             f"N/m per ridge (a flat ridge's closed form: "
             f"{m['load_to_touch_between_closed_form_N_per_m']:.3g}); here each pitch carries "
             f"{m['load_per_ridge_N_per_m']:.3g} N/m.",),
            {"contact": lambda: figures.contact(ds, setup.pitch_m)},
            {"contact": "The ridges stand out by many times the nominal pressure, but the film "
             "is deeper than the pitch: e^-kz leaves a thousandth of the wave."},
        ),
        Section(
            "The signal and the pitch",
            (f"The model's signal at the pitch has an amplitude of {micro['amplitude']:.3g} µV. "
             f"The resistor's noise is {micro['noise_rms']:.3g} µV rms over the whole band: "
             f"{m['snr_per_sample']:.2g} in each sample. Up to {m['band_hz']:.3g} Hz, twice the "
             f"ridges' frequency, it is {micro['noise_rms_in_band']:.2g} µV. Over "
             f"{settings.ridges} ridges d' is {m['strength_over_scan']:.3g}: the pitch comes "
             f"out as {1e3 * m['pitch_m']:.4f} ± {1e3 * m['pitch_m_stderr']:.4f} mm (Cramer-Rao "
             f"bound of one wave in this noise: {1e3 * m['pitch_m_stderr_bound']:.4f}).",
             f"A strip {1e3 * settings.blind_strip_width_m:.3g} mm wide gives "
             f"{micro['amplitude_blind_strip']:.1g} µV: it averages over its width, and over a "
             "whole pitch the average does not change."),
            {"signal": lambda: figures.signal(ds, setup.pitch_m, m["band_hz"])},
            {"signal": f"Dashed in the spectrum: what noise alone reaches anywhere in it with "
             f"probability {settings.false_alarm:g}."},
        ),
        Section(
            "How high a ridge has to be",
            (f"A wave of known pitch is found with probability {settings.detection:g} at a "
             f"false-alarm rate of {settings.false_alarm:g} if d' = {m['strength_needed']:.3g}: "
             f"for 6.5 µm after {1e3 * m['averaging_length_6.5um_m']:.3g} mm of sliding, for "
             f"0.65 µm after {1e3 * m['averaging_length_0.65um_m']:.3g} mm.",),
            {"size": lambda: figures.size(ds, drawn, float(setup.scene.nominal_pressure_Pa)),
             "detection": lambda: figures.detection(ds, drawn)},
            {"size": "Where the skin lies on the plate everywhere the signal is linear in the "
             "height; beside higher ridges it lifts off, and the signal grows faster. At a given "
             "height it is largest where the skin is about to reach the plate.",
             "detection": "Amplitudes average down as one over the root of the length."},
        ),
        Section(
            "Beside the paper",
            ("The paper calls its peaks at 6.5 µm \"large, distinct\" and expects ridges a tenth "
             "as high to be detectable. For peaks that stand "
             f"{settings.peak_over_noise:g} rms of noise out of the trace, this model's signal "
             "is "
             f"{m['snr_shortfall']:.3g} times too small in the whole band, and "
             f"{m['snr_shortfall_in_band']:.2g} times after a low-pass filter at "
             f"{m['band_hz']:.3g} Hz. The load does not make up for it: at "
             f"{1e-3 * m['amplitude_most_at_Pa']:.3g} kPa, the best of those tried, the amplitude "
             f"is {micro['amplitude_most']:.3g} µV.",
             "Averaging does: what is expected of a tenth of the height holds in this model for "
             f"a periodic texture and a slide of {m['averaging_length_0.65um_m']:.2g} m. Peaks "
             "that show at once have to come from what smooth sliding over a half space leaves "
             "out, such as stick and slip at the ridges, or from a film less deep."),
        ),
        Section(
            "What was assumed",
            (f"Plane strain, {setup.scene.skin.words}; "
             f"contact without adhesion, {'' if m['contact_converged'] else 'NOT '}converged"
             f", nominal pressure {float(setup.scene.nominal_pressure_Pa):g} Pa; q = "
             f"{float(setup.scene.surface.base_friction):g} p; endless ridges across the motion.",
             f"Film {1e3 * float(setup.sensor.depth_m):.3g} mm deep, "
             f"{setup.sensor.elements[0].strips} laminated strips "
             f"{1e3 * float(setup.sensor.elements[0].width_m):.3g} mm wide; "
             f"{float(setup.scan.speed_m_per_s):g} m/s; {settings.sample_rate_hz:g} samples per "
             f"second, {rest}",),
        ),
    )  # fmt: skip
