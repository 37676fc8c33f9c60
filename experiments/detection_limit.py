"""Detection limit of a ridge and resolution limit of a pair, over depth, noise and speed."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray
from jaxtyping import Array, Float

from srsinv import config
from srsinv.errors import BadInput, number, refuse, whole
from srsinv.forward.noise import Noise, total_spectrum
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import Scene, SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface import Ridge, Surface
from srsinv.grid import Line, Periodic
from srsinv.inverse import detection
from srsinv.report.figures import limits as figures
from srsinv.report.outcome import Outcome, Section, Table
from srsinv.report.text import listed

AXES = {
    "depth": ("depth_range_m", "m"),
    "noise": ("noise_range_V", "V"),
    "speed": ("speed_range_m_per_s", "m/s"),
}
LIMITS = ("least_height", "narrowest_pair", "resolved_wavelength")


@dataclass(frozen=True)
class LimitSettings:
    """`detection_limit` of the configuration.

    The limits' probabilities, the precision of a distance over its standard error, samples per
    second, and what is tried: `axes` (by name) of depth [m], noise [V] and speed [m/s], heights of
    single ridges [m], and distances of pairs [m], before they are whole cells.
    """

    sample_rate_hz: float
    false_alarm: float
    detection: float
    relative_precision: float
    axes: dict[str, np.ndarray]
    heights_m: np.ndarray
    distances_m: np.ndarray

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> "LimitSettings":
        """Those given; raises `BadInput` for ranges that do not increase and numbers out of
        range."""
        wanted = "a positive number in Hz"
        return cls(
            axes={name: _range(given, key, "points") for name, (key, _) in AXES.items()},
            heights_m=_range(given, "height_range_m", "heights"),
            distances_m=_range(given, "distance_range_m", "distances"),
            sample_rate_hz=number(
                "detection_limit.sample_rate_hz", given["sample_rate_hz"], wanted, above=0
            ),
            false_alarm=given["false_alarm"],
            detection=given["detection"],
            relative_precision=given["relative_precision"],
        )

    @property
    def strength(self) -> float:
        """The d' that a ridge needs; raises `BadInput` for probabilities that are none."""
        return detection.needed_known(self.false_alarm, self.detection)


class RidgeSetup(NamedTuple):
    """A sensor that slides over one ridge, on a periodic line."""

    line: Line
    scene: SurfaceScene
    ridge: Ridge
    sensor: Sensor
    scan: ConstantSpeed


class RidgeTractions(NamedTuple):
    """Traction (2, n) [Pa] of every ridge, and of every pair with its derivatives by height,
    position and distance; `converged` of all."""

    ridge: Float[Array, "height 2 n"]
    pair: Float[Array, "distance 2 n"]
    slopes: Float[Array, "distance 3 2 n"]
    converged: bool


def run(cfg: config.Config) -> Outcome:
    """Both limits along three axes, one quantity varied at a time.

    Raises `BadInput` for another scene than one ridge, noise that is not white, and ranges that do
    not increase.
    """
    settings = LimitSettings.checked(cfg["detection_limit"])
    axes, heights, rate = settings.axes, settings.heights_m, settings.sample_rate_hz
    needed = settings.strength
    with config.precision(cfg):
        setup = _setup(config.line(cfg), config.scene(cfg), config.sensor(cfg), config.scan(cfg))
        distances = _distances(settings.distances_m, setup)
        tractions = _solve_contacts(setup, heights, distances)
        depth, speed = float(setup.sensor.depth_m), float(setup.scan.speed_m_per_s)
        noise = _white(config.noises(cfg), setup, tractions, rate)
        base = (depth, noise, speed)
        detectability = _detectability(setup, tractions, rate)

        def limits(at):
            z, sigma, u = at
            strength, pair_strength, stderr = (np.asarray(v) for v in detectability(z, u))
            return (
                _crossing(heights, needed * sigma / strength),
                _crossing(distances, settings.relative_precision * sigma * stderr / distances),
                _resolved_wavelength(z, pair_strength[-1] / sigma),
            )

        curves = {
            name: np.array([limits(_with(base, i, value)) for value in axes[name]]).T
            for i, name in enumerate(AXES)
        }
        here = limits(base)

    metrics: dict[str, Any] = {
        "least_height_m": here[0],
        "narrowest_pair_m": here[1],
        "resolved_wavelength_m": here[2],
        "least_distance_m": distances[0],
        "noise_rms_V": noise,
        "strength_needed": needed,
        "contact_converged": tractions.converged,
    } | _along(axes, curves, (heights[0], distances[0]))
    metrics = {k: v if isinstance(v, bool) else float(v) for k, v in metrics.items()}
    effects = listed(cfg["effects"])
    dataset = xarray.Dataset(
        {
            f"{limit}_against_{name}": (name, curves[name][i], {"units": "m"})
            for i, limit in enumerate(LIMITS)
            for name in AXES
        },
        {name: (name, axes[name], {"units": unit}) for name, (_, unit) in AXES.items()},
    )
    return Outcome(
        f"Least ridge {1e6 * here[0]:.3g} µm, narrowest pair {1e3 * here[1]:.3g} mm, "
        f"{1e3 * depth:.3g} mm deep",
        metrics,
        dataset,
        _sections(dataset, metrics, settings, setup, dict(zip(AXES, base, strict=True)), effects),
        _ends_table(axes, curves),
    )


def _along(axes, curves, floors) -> dict[str, Any]:
    """Each limit at both ends of each axis, and the power of the axis that it follows above the
    least height and distance tried, `floors`."""
    ends = {
        f"{limit}_at_{end}_{name}_m": curves[name][i, j]
        for i, limit in enumerate(LIMITS[:2])
        for name in AXES
        for end, j in (("least", 0), ("most", -1))
    }
    return ends | {
        f"{limit}_against_{name}_exponent": _exponent(axes[name], curves[name][i], floor)
        for i, (limit, floor) in enumerate(zip(LIMITS, floors, strict=False))
        for name in AXES
    }


def _ends_table(axes, curves) -> Table:
    return Table(
        ("varied", "from", "to", "least height [µm]", "", "narrowest pair [mm]", ""),
        tuple(
            (f"{name} [{unit}]", axes[name][0], axes[name][-1],
             *(1e6 * curves[name][0, [0, -1]]), *(1e3 * curves[name][1, [0, -1]]))
            for name, (_, unit) in AXES.items()
        ),
        "Each limit at both ends of the range.",
    )  # fmt: skip


def _range(given: Mapping[str, Any], key: str, count: str) -> np.ndarray:
    name, ends = f"detection_limit.{key}", given[key]
    refuse(
        not isinstance(ends, list) or len(ends) != 2,
        f"{name} is {ends}: give [least, greatest].",
    )
    low = number(name, ends[0], "[least, greatest], both positive", above=0)
    high = number(name, ends[1], "[least, greatest], the second the larger", above=low)
    name, wanted = f"detection_limit.{count}", "a whole number from 3"
    return np.geomspace(low, high, whole(name, given[count], wanted, least=3))


def _setup(line: Line, scene: Scene, sensor: Sensor, scan: ConstantSpeed) -> RidgeSetup:
    surface = scene.contact_scene
    ridge = surface and surface.surface.only(Ridge)
    if surface is None or ridge is None:
        raise BadInput("The scene is not one ridge: use scene=ridge.")
    refuse(not isinstance(line, Periodic), "grid.line is open: give periodic.")
    speed = float(scan.speed_m_per_s)
    refuse(speed <= 0, f"scan.speed_m_per_s is {speed}: give a positive speed in m/s.")
    return RidgeSetup(line, surface, ridge, sensor, scan)


def _distances(wanted: np.ndarray, setup: RidgeSetup) -> np.ndarray:
    """The wanted distances in whole pairs of cells."""
    line, step = setup.line, 2 * float(setup.line.cell_m)
    distances = step * np.unique(np.round(wanted / step))
    width, window = float(setup.ridge.width_m), line.n * float(line.cell_m)
    ends = [float(wanted[0]), float(wanted[-1])]
    refuse(
        not width + step < distances[0] < distances[-1] < window / 2,
        f"detection_limit.distance_range_m is {ends}: give distances above "
        f"the ridge's width {width:g} m by more than two cells ({step:g} m), and below half the "
        f"window's {window:g} m.",
    )
    return distances


def _solve_contacts(setup: RidgeSetup, heights, distances) -> RidgeTractions:
    """Contact with single ridges of `heights` and pairs at `distances`: the only nonlinear part,
    and independent of depth and speed.

    Ridges are moved by whole cells: the derivative of the contact jumps where a cell touches or
    parts on a steep edge, which would scatter the standard errors by a tenth.
    """
    line, scene, ridge = setup.line, setup.scene, setup.ridge

    def traction(shapes):
        surface = Surface(shapes, scene.surface.base_friction)
        contact = eqx.tree_at(lambda s: s.surface, scene, surface).contact(line)
        p = contact.pressure_Pa
        return jnp.stack([p, surface.friction(line) * p]), contact.converged

    def placed(height, position):
        return eqx.tree_at(lambda r: (r.height_m, r.position_m), ridge, (height, position))

    def pair(height, cells):
        sides = (placed(height, ridge.position_m + each * line.cell_m) for each in (-cells, cells))
        return traction(tuple(sides))

    def with_slopes(cells):
        (here, right), (by_height, _) = jax.jvp(
            lambda height: pair(height, cells), (ridge.height_m,), (jnp.ones_like(ridge.height_m),)
        )
        by_place = (jnp.roll(here, -1, -1) - jnp.roll(here, 1, -1)) / (2 * line.cell_m)
        apart, near = pair(ridge.height_m, cells + 1)[0], pair(ridge.height_m, cells - 1)[0]
        by_distance = (apart - near) / (4 * line.cell_m)
        return here, jnp.stack([by_height, by_place, by_distance]), right

    def one(height):
        return traction((placed(height, ridge.position_m),))

    single, right = jax.jit(lambda h: jax.lax.map(one, h))(jnp.asarray(heights))
    cells = jnp.round(jnp.asarray(distances) / (2 * line.cell_m))
    both, slopes, as_well = jax.jit(lambda d: jax.lax.map(with_slopes, d))(cells)
    return RidgeTractions(single, both, slopes, bool(right.all() & as_well.all()))


def _detectability(setup: RidgeSetup, tractions: RidgeTractions, rate: float):
    """Map from (depth, speed), in white noise of 1 V, to d' (height,) of single ridges, d' and the
    Cramer-Rao standard error [m] of the distance (distance,) of pairs. One program for all."""
    line, sensor = setup.line, setup.sensor

    @jax.jit
    def at(depth, speed):
        films = [film.depth_m for film in sensor.elements]
        moved = [z + depth - sensor.depth_m for z in films]
        deeper = eqx.tree_at(lambda s: [film.depth_m for film in s.elements], sensor, moved)
        field = deeper.operator(line, ConstantSpeed(speed))
        samples = rate / speed * line.cell_m  # for each cell

        def strength(traction):
            return jnp.sqrt(samples * jnp.sum(field(traction) ** 2))

        def stderr(slopes):
            columns = jnp.sqrt(samples) * jax.vmap(field)(slopes).reshape(3, -1)
            # Scaled: heights are in micrometres, distances in millimetres.
            size = jnp.linalg.norm(columns, axis=1)
            triangle = jnp.linalg.qr((columns / size[:, None]).T, mode="r")
            return 1 / (jnp.abs(triangle[2, 2]) * size[2])

        return (
            jax.lax.map(strength, tractions.ridge),
            jax.lax.map(strength, tractions.pair),
            jax.lax.map(stderr, tractions.slopes),
        )

    return lambda depth, speed: at(jnp.asarray(depth, float), jnp.asarray(speed, float))


def _white(
    noises: tuple[Noise, ...], setup: RidgeSetup, tractions: RidgeTractions, rate: float
) -> float:
    """Noise [V rms] of one sample at `rate`."""
    line, scan = setup.line, setup.scan
    samples = Periodic(line.n, float(scan.speed_m_per_s) / rate, 0.0)
    rms = jnp.sqrt(jnp.mean(setup.sensor.operator(line, scan)(tractions.pair[-1]) ** 2))
    spectrum = np.asarray(total_spectrum(noises, samples, scan, rms))
    refuse(
        not spectrum.min() > 0 or float(np.ptp(spectrum)) > 1e-9 * spectrum.max(),
        "The noise is not white, which is assumed here: give noise=[johnson] or noise=[white].",
    )
    return float(np.sqrt(spectrum[0]))


def _with(values: tuple, index: int, value: Any) -> tuple:
    return (*values[:index], float(value), *values[index + 1 :])


def _crossing(at: np.ndarray, falling: np.ndarray) -> float:
    """Last crossing of `falling` (at,) below 1: NaN where there is none, and the first of `at`
    where it is always below."""
    above = np.flatnonzero(~(falling < 1))
    if not above.size:
        return float(at[0])
    i = above[-1]
    if i == at.size - 1:
        return np.nan
    x, y = np.log(at[i : i + 2]), np.log(falling[i : i + 2])
    return float(np.exp(x[0] - y[0] * (x[1] - x[0]) / (y[1] - y[0])))


def _resolved_wavelength(depth_m: float, strength: float) -> float:
    """The wavelength [m] at which e^(-kz) attenuates a signal of this strength to the noise."""
    return 2 * np.pi * depth_m / np.log(strength) if strength > 1 else np.nan


def _exponent(at, values, floor: float) -> float:
    """The slope of a straight line through the logarithms, without NaN and values at `floor`."""
    good = np.isfinite(values) & (values > floor)
    if good.sum() < 2:
        return np.nan
    return float(np.polyfit(np.log(at[good]), np.log(values[good]), 1)[0])


def _sections(
    ds, m, settings: LimitSettings, setup: RidgeSetup, base, effects: str
) -> tuple[Section, ...]:
    ridge, scene = setup.ridge, setup.scene
    law = {key.removesuffix("_exponent"): f"{m[key]:.2f}" for key in m if "_exponent" in key}
    return (
        Section(
            "The least ridge that is found",
            (f"Found by a filter matched to its signal with probability {settings.detection:g}, "
             f"at a false-alarm rate of {settings.false_alarm:g}: d' = "
             f"{m['strength_needed']:.3g}. {1e6 * float(ridge.width_m):.3g} µm wide, it has to be "
             f"{1e6 * m['least_height_m']:.3g} µm high.",
             f"Over the ranges drawn it goes as depth^{law['least_height_against_depth']}, "
             f"noise^{law['least_height_against_noise']} and "
             f"speed^{law['least_height_against_speed']}. A rate signal grows as the speed and the "
             "samples on a ridge fall as one over it, so that d' goes as its root. Where the skin "
             "stays on the plate d' is linear in the height, the law is noise over root speed; "
             "beside higher ridges it lifts off, d' rises faster, and the exponents are smaller.",),
            {"least_height": lambda: figures.heights(ds, base)},
            {"least_height": "Dots: this sensor. One quantity is varied at a time."},
        ),
        Section(
            "The narrowest pair",
            (f"Two ridges {1e6 * float(ridge.height_m):.3g} µm high are told apart where the "
             "distance of their middles is known to one part in "
             f"{settings.relative_precision:g}: its Cramer-Rao standard error, with their "
             "height and place unknown as well (width, friction and pressure known). Here "
             f"{1e3 * m['narrowest_pair_m']:.3g} mm; it goes as "
             f"depth^{law['narrowest_pair_against_depth']}, "
             f"noise^{law['narrowest_pair_against_noise']} and "
             f"speed^{law['narrowest_pair_against_speed']}.",
             f"Without such a model, what is kept are wavelengths above 2πz/ln(d') = "
             f"{1e3 * m['resolved_wavelength_m']:.3g} mm, where e^-kz has brought a signal of the "
             "pair's d' down to the noise. A parametric fit goes below: it asks for one number, "
             "not for a picture, and knows what stands there.",),
            {"narrowest_pair": lambda: figures.pairs(ds, base, m["least_distance_m"])},
            {"narrowest_pair": "Two close ridges differ from one by their spread alone, as the "
             "square of the distance: the limit falls slowly with the noise. Where it lies on the "
             "dotted line all pairs tried are told apart."},
        ),
        Section(
            "What was assumed",
            ("Half space in plane strain, contact without adhesion, "
             f"{'' if m['contact_converged'] else 'NOT '}converged, nominal pressure "
             f"{float(scene.nominal_pressure_Pa):g} Pa over the window, "
             f"q = {float(scene.surface.base_friction):g} p.",
             f"{len(setup.sensor.elements)} film elements {1e3 * base['depth']:.3g} mm deep, "
             f"{base['speed']:g} m/s, {settings.sample_rate_hz:g} samples per second, white "
             f"noise of {1e6 * base['noise']:.3g} µV rms in each. Place of the single ridge known. "
             f"Effects on: {effects}.",),
        ),
    )  # fmt: skip
