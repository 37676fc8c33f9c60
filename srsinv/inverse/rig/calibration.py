"""Calibration of a rig: what its films are and how its channels are wired, from a known feature.

Over a feature whose shape and load are known the traction is known but for its place x0 and the
friction mu. The signal of element e is then

    v_e(t) = g_e R_f u d/dx [(K_p + s mu K_q) * p](x(t) + o_e - x0),    s = sign(u),

K_p and K_q the film's responses at its depth and angle (docs/explanation/physics, stress to
readout). The gains enter linearly and are solved out; x0, mu, the depth, and the angles and offsets
of all elements but the first, which the others are measured from, are searched. Nothing of the rig
changes the contact but for the feature's place: it is solved ahead of a fit, and again where that
finds it. Where the feature lies is searched with a rig that is known roughly.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import BadInput, check_name, number, refuse
from ...forward.operator import PositionInterpolation
from ...grid import as_real
from ...resolution import cell_m
from ...status import Status
from ..diagnostics import local_misfit
from ..features.contact import are_noticed, cells_may_show
from ..features.identifiability import limited_by_bounds
from ..features.misfit import excess_of
from ..features.search import Blocks
from ..noise.residual import ResidualNoise, residual_noise
from ..noise.sliding import Levels, first_levels
from ..nonlinear import Fit, fit
from ..problem import Problem
from ..quality import Quality, quality, reasons
from .model import KnownTraction, RigModel

TRIED_DEPTHS = (0.7, 1.0, 1.4)  # of the stated depth, in the search for the feature's place
SEARCHED = 4_000  # means of samples at most, in that search


@compiled
def _unit_signals(model: RigModel, first: Any, depths: Float[Array, " a"], places):
    """The signals (a, b, part, e, sample) at gains of one, at depths and places (b,) tried: of
    pressure, and of the shear of a friction of one. What the electronics do in time is left out."""
    motion, pressure = model.motion, model.pressure_Pa
    nothing = jnp.zeros_like(pressure)
    turn = jnp.where(motion.direction < 0, -1.0, 1.0)

    def at_depth(depth):
        sensor = model.sensor_of(first | {"depth_m": depth})
        operator = sensor.operator_along(model.line, motion, directions=model.directions)
        fields = [
            operator.field(jnp.stack(pair)) for pair in ((pressure, nothing), (nothing, pressure))
        ]

        def at_place(place):
            at = PositionInterpolation(model.line, motion.position_m + model.place_m - place)
            alone, shear = (operator.gain * at(field) for field in fields)
            return jnp.stack([alone, turn * shear])

        return jax.lax.map(at_place, places)

    return jax.lax.map(at_depth, depths)


def feature_start(
    model: RigModel, y: Float[np.ndarray, "e sample"], first: Mapping[str, Any], free: list[str]
) -> dict[str, float]:
    """Where the feature is, and a first depth and gains: those whose signals, of pressure and of
    shear in any ratio in each channel, leave least of the data."""
    depth, x = float(first["depth_m"]), np.asarray(model.motion.position_m)
    blocks = Blocks(model.motion, max(depth / 4, float(np.sum(np.abs(np.diff(x)))) / SEARCHED))
    coarse = eqx.tree_at(lambda m: m.motion, model, blocks.motion)
    places = np.arange(x.min() - depth, x.max() + depth, depth / 3)
    places = places if "position_m" in free else np.array([first["position_m"]])
    depths = depth * np.array(TRIED_DEPTHS if "depth_m" in free else (1.0,))
    own = {name: as_real(value) for name, value in first.items()}
    signals = np.asarray(_unit_signals(coarse, own, as_real(depths), as_real(places)))
    tried = np.stack(np.meshgrid(depths, places, indexing="ij"), axis=-1)
    means = blocks.means(np.nan_to_num(y))
    observed = blocks.means(np.isfinite(y).astype(float)) > 0.5
    white = first_levels(y, depth).white
    best, most = None, -np.inf
    rows = zip(tried.reshape(-1, 2), signals.reshape(-1, *signals.shape[2:]), strict=True)
    for row, unit in rows:
        gains, ratios, explained = [], [], 0.0
        for e in range(len(y)):
            columns, data = unit[:, e, observed[e]].T, means[e, observed[e]]
            if model.free_offset:
                columns, data = columns - columns.mean(axis=0), data - data.mean()
            parts, *_ = np.linalg.lstsq(columns, data, rcond=1e-9)
            explained += float(data @ columns @ parts) / white[e] ** 2
            gains.append(float(parts[0]))
            ratios.append(parts[1] / parts[0] if parts[0] else 0.0)
        if explained > most:
            mu = float(np.clip(np.median(ratios), -1, 1))
            best, most = (row, gains, mu), explained
    assert best is not None
    (depth, place), gains, mu = best
    start = {"depth_m": float(depth), "position_m": float(place), "base_friction": mu}
    start |= {f"gain_{e}": gain for e, gain in enumerate(gains, 1)}
    return {name: value for name, value in start.items() if name in free}


DEPTH_RANGE = 3.0  # factor about the stated depth
MOST_ANGLE_RAD = np.pi / 4  # about the stated angle: half a turn more is another polarity
MOST_FRICTION = 3.0
SLACK = 4.0  # depths that the feature may move in the fit
MOST_SOLVED = 4  # contacts, with the feature elsewhere or on finer cells


@dataclass(frozen=True)
class Calibration:
    """A rig that was fitted.

    - `parameters`: value and standard error by name, of those that were free, angles in degrees;
      the error is infinite where the data do not determine it. `covariance`: in their order.
    - `fit`, `model`; `known`: the traction of the feature; `data`, `fitted` (e, sample); `levels`:
      the noise.
    """

    fit: Fit
    known: KnownTraction
    model: RigModel
    data: Float[np.ndarray, "e sample"]
    levels: Levels
    noise_warnings: tuple[str, ...]

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Value and standard error by name."""
        fit, unsure = self.fit, limited_by_bounds(self.fit)
        errors = {n: np.inf if n in unsure else float(fit.stderr[n]) for n in self._own}
        return {
            reported_name(n): (unit * float(fit.value[n]), unit * errors[n])
            for n, unit in self._own.items()
        }

    @property
    def covariance(self) -> Float[np.ndarray, "m m"]:
        """That of the parameters."""
        at, unit = [self.fit.names.index(n) for n in self._own], [*self._own.values()]
        return np.outer(unit, unit) * self.fit.covariance[np.ix_(at, at)]

    @property
    def _own(self) -> dict[str, float]:
        """The fit's names of the rig's parameters, and the units that they are reported in."""
        own = [name for name in self.fit.names if not name.startswith("offset[")]
        return {name: 180 / np.pi if name.endswith("_rad") else 1.0 for name in own}

    @property
    def status(self) -> Status:
        """How the search ended."""
        return self.fit.status

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against the standard errors, as sentences."""
        return (*self.fit.warnings, *self.noise_warnings)

    @property
    def quality(self) -> Quality:
        """Good, doubtful or failed."""
        freedom = self.fit.stats["degrees_of_freedom"]
        return quality(self.status, self.fit.known_chi2, self.warnings, freedom)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the quality is not good, as sentences."""
        return reasons(self.status, self.warnings)

    @property
    def fitted(self) -> Float[np.ndarray, "e sample"]:
        """The fitted signal."""
        return np.asarray(self.model(jax.tree.map(as_real, self.fit.value)))

    @property
    def whitened(self) -> Float[np.ndarray, "e sample"]:
        """What is left, in units of the noise; NaN where a sample is missing."""
        observed = np.isfinite(self.data)
        return np.where(observed, np.reshape(self.fit.whitened, observed.shape), np.nan)


def calibrate(
    problem: Problem, feature: Any, held: Mapping[str, float], free: Any = None
) -> Calibration:
    """The rig's gains, depth, angles and offsets, from signals over a known feature.

    - `problem`: with the sensor as it is stated, from which the search begins.
    - `held`: what is known, by name: of the feature all but its place; of the rig whatever is.
    - `free`: names of what is fitted; None: all that is not held.

    Raises `BadInput` for parameters that are not held, unknown names, names that are both, and a
    place that is far from the scan.
    """
    pressure = problem.nominal_pressure_Pa
    if feature.is_of_surface and pressure is None:
        raise BadInput(
            "The nominal pressure on the surface is not known: give "
            "recording.nominal_pressure_Pa, the mean over the contact window."
        )
    problem = problem.aligned()
    known = KnownTraction.of(problem, feature, held, float(pressure or 0.0))
    samples, x = problem.samples(), np.asarray(problem.motion.position_m)
    depth = float(problem.sensor.depth_m)
    cell, least, most = cell_m("load", depth), float(x.min()), float(x.max())
    # The feature may be anywhere: first the line is long enough for that.
    reach = most - least + 2 * depth
    anywhere = known.over(known.place_m - reach, known.place_m + reach, cell)
    model = RigModel.on(problem, anywhere)
    stated = _stated(model)
    first = stated | _held_in_rig(stated, feature, held)
    refuse(
        "position_m" in held and not least - reach <= first["position_m"] <= most + reach,
        f"fit.hold.position_m is {first['position_m']:.6g}: give a position within "
        f"the scan, from {least:.6g} m to {most:.6g} m.",
    )
    names = _free_names(first, feature, held, free)
    noise = residual_noise(problem, samples)
    clean = noise.without_waves(samples.signal)
    first |= feature_start(model, clean, first, names)

    def at(place_m: float, finer: int) -> tuple[KnownTraction, RigModel]:
        known = KnownTraction.of(problem, feature, held, float(pressure or 0.0), place_m, finer)
        near = known.over(least - SLACK * depth, most + SLACK * depth, cell)
        return known, RigModel.on(problem, near)

    return _converged(at, samples.signal, noise, first, names)


# --- parameters --------------------------------------------------------------------------------


def _stated(model: RigModel) -> dict[str, Any]:
    """The parameters as the sensor is stated."""
    films = list(enumerate(model.sensor.elements, 1))
    offset = {"offset": np.zeros(len(films))} if model.free_offset else {}
    return {
        **{f"gain_{n}": 1.0 for n, _ in films},
        "depth_m": float(model.sensor.depth_m),
        "position_m": float(model.place_m),
        "base_friction": 0.0,
        **{f"angle_{n}_rad": float(film.angle_rad) for n, film in films[1:]},
        **{f"offset_{n}_m": float(film.offset_m) for n, film in films[1:]},
        **offset,
    }


def reported_name(name: str) -> str:
    """A parameter's name in results, where angles are in degrees."""
    return f"{name.removesuffix('_rad')}_deg" if name.endswith("_rad") else name


def _own_names(stated: Mapping[str, Any], feature: Any) -> tuple[dict[str, str], list[str]]:
    """Names in results with those in the model, of the rig; and those of the feature."""
    rig = {reported_name(name): name for name in stated if name != "offset"}
    load = [] if feature.is_of_surface else [feature.amplitude]
    return rig, [name for name in (*feature.axes, *load) if name != "position_m"]


def _held_in_rig(
    stated: Mapping[str, Any], feature: Any, held: Mapping[str, Any]
) -> dict[str, float]:
    """What is held of the rig, by the model's names."""
    rig, shape = _own_names(stated, feature)
    for name, value in held.items():
        check_name("fit.hold", name, [*shape, *rig])
        number(f"fit.hold.{name}", value, "a number, in the unit at the name's end")
    return {
        rig[name]: float(np.deg2rad(value) if name.endswith("_deg") else value)
        for name, value in held.items()
        if name in rig
    }


def _free_names(
    stated: Mapping[str, Any], feature: Any, held: Mapping[str, Any], free: Any
) -> list[str]:
    """The model's names of what is fitted."""
    rig, _ = _own_names(stated, feature)
    named = list(rig) if free is None else list(free)
    for name in named if free is not None else ():
        check_name("fit.free", name, rig)
        refuse(
            name in held,
            f"{name} is named both in fit.free and in fit.hold: leave it out of one of them.",
        )
    # Where the feature lies and how it rubs is known of no rig.
    always = [name for name in ("position_m", "base_friction") if name not in named]
    chosen = [rig[name] for name in (*named, *always) if name not in held]
    return [*chosen, *(["offset"] if "offset" in stated else [])]


def _bounds(model: RigModel, first: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    depth = float(model.sensor.depth_m)
    bounds = {
        "depth_m": (depth / DEPTH_RANGE, depth * DEPTH_RANGE),
        "base_friction": (-MOST_FRICTION, MOST_FRICTION),
    }
    place = float(model.place_m)
    bounds["position_m"] = place - SLACK * depth, place + SLACK * depth
    for n, film in list(enumerate(model.sensor.elements, 1))[1:]:
        angle, offset = float(film.angle_rad), float(film.offset_m)
        bounds[f"angle_{n}_rad"] = angle - MOST_ANGLE_RAD, angle + MOST_ANGLE_RAD
        bounds[f"offset_{n}_m"] = offset - 4 * depth, offset + 4 * depth
    return bounds


# --- the fit -----------------------------------------------------------------------------------


def _converged(
    at: Callable[[float, int], tuple[KnownTraction, RigModel]],
    y: Float[np.ndarray, "e sample"],
    noise: ResidualNoise,
    first: dict[str, Any],
    free: list[str],
) -> Calibration:
    """The fit with contact solved where the feature was found, on cells so fine that half as wide
    ones move no parameter noticeably; what is left after `MOST_SOLVED` is in the errors."""
    finer, moves = 1, np.zeros(0)
    made = _fitted(*at(first["position_m"], finer), y, noise, first, free)
    for _ in range(MOST_SOLVED):
        value = dict(made.fit.value)
        finer *= 2 if cells_may_show(made.fit) else 1
        known, better = at(float(value["position_m"]), finer)
        moves = made.fit.moves(np.asarray(better(jax.tree.map(as_real, value))) - made.fitted)
        if not are_noticed(moves, made.fit):
            return made
        made = _fitted(known, better, y, noise, value, free)
    return replace(made, fit=made.fit.with_error(moves))


def _fitted(
    known: KnownTraction,
    model: RigModel,
    y: Float[np.ndarray, "e sample"],
    noise: ResidualNoise,
    first: dict[str, Any],
    free: list[str],
) -> Calibration:
    """The fit and its noise in turn, until the noise no longer changes."""
    bounds = {n: b for n, b in _bounds(model, first).items() if n in free}
    for name, (low, high) in bounds.items():
        first[name] = float(np.clip(first[name], low, high))
    linear = [name for name in model.linear if name in free]

    def fitted(start: Mapping[str, Any], white: Any) -> Fit:
        return fit(model, start, y, noise=white, bounds=bounds, free=free, linear=linear)

    levels = noise.first(y)
    result = fitted(first, noise.whitener(levels, y))
    result, levels = noise.settled(fitted, result, levels, y)
    against = noise.warnings(levels, y, result)
    place, depth = noise.motion.position_m, noise.depth_m
    if result.quality is not Quality.FAILED:  # else its residual says that no band holds
        against = (*against, *local_misfit(excess_of(result, y, place, depth)))
    return Calibration(result, known, model, y, levels, against)
