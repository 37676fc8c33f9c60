"""A cylinder that the skin touches alone: a Hertz pressure, turned with the cylinder's axis.

The load on its axis is F = p0 L cos(phi) [N/m], of the nominal pressure p0 over a window of length
L along the scan, which the axis crosses at the angle phi from straight across. The half-width of
contact is a = sqrt(4 F R/(pi E*)) (Johnson 1985, 4.3). Along the scan all lengths across the
cylinder are longer by 1/cos(phi), so that a wave of k along it has k/cos(phi) across the cylinder.

The contact blurs the signal by the variance a^2/4 of its pressure, and the strip's length l by
(l sin(phi))^2/12. Where both are small beside the film's depth nothing else shows them: near phi =
0 the data determine their sum, and the radius where the angle is known.

The pressure is that of line loads at Gauss's nodes: exact for waves of k a < the number of nodes.
They lie on cells by the quadratic B-spline, which the operator takes out again.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import BadInput, refuse
from ...forward.feature import ScanExtent
from ...forward.oblique import turned
from ...forward.operator import MotionOperator
from ...forward.scan import Motion
from ...forward.sensor import Sensor
from ...forward.skin import Skin
from ...forward.surface import Cylinder
from ...forward.surface_feature import LEAST_RADIUS_M, LEAST_SINE_SQUARED, CylinderFeature
from ...forward.traction import Hertz, LineLoad
from ...forward.turned_skin import TurnedSkin
from ...grid import Convolution, Line, Scalar, as_real, sinc, wavenumbers
from ...numerics import BAND_90, fast_length, shared_count
from ...quantities import quantity
from ..nonlinear import Fit
from ..rig.setup import Setup
from .contact import AT_ONCE, MOST_SHIFTED, ContactLoading
from .identifiability import undetected_features
from .loading import Features, Traction, TrialShapes

NODES = 32
ANGLE = "sine_squared"
NATURAL = {"radius_m": LEAST_RADIUS_M, ANGLE: LEAST_SINE_SQUARED}  # below which there is nothing
SPAN = 8  # windows after which an open line repeats
DISTINCT = 2.0  # standard errors from zero: a parameter nearer to it is not identified
MOST_SLOPE = 0.5  # of the contact's half-width over the radius: Hertz takes it as small


class CylinderLoading(ContactLoading):
    """The traction of a cylinder that the skin touches nowhere else, as it slides over it.

    Fields are those of [`ContactLoading`][]. The signal is that of the contact alone, beyond which
    there is no pressure; the pressures that are reported are those beyond the nominal one.
    """

    # --- the model ---

    def pressure(self, line: Line, features: Features, params: Any) -> Hertz:
        """The pressure along the scan."""
        ((name, feature),) = features.items()
        own, c = params[name], jnp.cos(angle_of(feature, params[name]))
        load = params["nominal_pressure_Pa"] * line.n * line.cell_m  # per length along the scan
        half = half_width(self.sensor.skin, c * load, own["radius_m"]) / c
        return Hertz(2 * load / (jnp.pi * half), half, own["position_m"])

    def tractions(
        self, line: Line, features: Features, params: Any, directions: tuple[bool, ...]
    ) -> list[Traction]:
        hertz = self.pressure(line, features, params)
        load = jnp.pi / 2 * hertz.pressure_Pa * hertz.half_width_m
        at = np.arange(1, NODES + 1) * np.pi / (NODES + 1)
        places = hertz.position_m + hertz.half_width_m * np.cos(at)
        parts = 2 / (NODES + 1) * np.sin(at) ** 2

        def on_cells(place):
            return LineLoad(1.0, place).bspline_average(line.x, line.cell_m)

        p = load * parts @ jax.vmap(on_cells)(places)
        q = params["base_friction"] * p
        return [jnp.stack([p, q if forward else -q]) for forward in directions]

    def cell_traction(self, line: Line, features: Features, params: Any, onto: Line) -> Traction:
        p = self.pressure(line, features, params).cell_average(onto)
        p = p - params["nominal_pressure_Pa"]
        return jnp.stack([p, params["base_friction"] * p])

    def profiles(self, line: Line, features: Features, params: Any) -> Float[Array, "profile n"]:
        """The height is that of the cylinder along the scan; beside the contact the gap is from the
        skin as Hertz's pressure displaces it."""
        ((name, feature),) = features.items()
        hertz = self.pressure(line, features, params)
        c = jnp.cos(angle_of(feature, params[name]))
        p, q = self.cell_traction(line, features, params, line)
        height = Cylinder(params[name]["radius_m"] / c, hertz.position_m).height(line) * c
        # Beside the contact, at s = x/a, the gap from a parabola rises as a/R sqrt(s^2 - 1).
        s = jnp.abs(line.x - hertz.position_m) / hertz.half_width_m
        outside = s > 1
        s = jnp.where(outside, s, 2.0)
        curved = (c * hertz.half_width_m) ** 2 / (2 * params[name]["radius_m"])
        gap = curved * (s * jnp.sqrt(s**2 - 1) - jnp.arccosh(s) - s**2) - height
        friction = jnp.full(line.n, params["base_friction"])
        return jnp.stack([p, q, height, jnp.where(outside, gap, 0.0), friction])

    def operator(self, operator: MotionOperator, features: Features, params: Any) -> MotionOperator:
        ((name, feature),) = features.items()
        line, sensor = operator.line, self.sensor_at(params)
        c = 1.0
        if feature.angle_deg != 0:
            refuse_turned(sensor.skin)
            angle = angle_of(feature, params[name])
            c, sensor = jnp.cos(angle), turned(sensor, angle)
        circle = line.n if operator.field.is_circular else fast_length(SPAN * line.n)
        k = wavenumbers(circle, line.cell_m)
        order = self.sensor.amplifier.order
        charge = (
            (1j * k) ** order * sensor.charge().transfer(k / c) / sinc(k * line.cell_m / 2) ** 3
        )
        if not operator.field.is_circular:
            # The sum over waves is then the integral of what has a kink at k = 0, as a rate's
            # response to shear has (Euler and Maclaurin).
            rise = 2 * charge[..., 1].real - charge[..., 2].real / 2
            charge = charge.at[..., 0].add(rise * order / 6)
        has_dc_gain = operator.field.has_dc_gain
        field = Convolution(charge, line.cell_m, line.n, circle, has_dc_gain)
        return dataclasses.replace(operator, field=field)

    def with_operator_of(self, sensor: Sensor, motion: Motion) -> "CylinderLoading":
        films = dataclasses.replace(sensor, skin=self.sensor.skin)
        return dataclasses.replace(self, sensor=films, motion=motion)

    def params_at(self, features: Features, params: Any, setup: Setup) -> Any:
        if "nominal_pressure_Pa" in self.also:
            return params
        pressure = setup.nominal_pressure * self.nominal_pressure_Pa
        return params | {"nominal_pressure_Pa": pressure}

    def steps(self, line: Line, features: Features) -> dict[str, float]:
        """None: the pressure is smooth in all parameters."""
        del line, features
        return {}

    # --- the search ---

    def trial_shapes(
        self, model: Any, feature: Any, stretch: ScanExtent, given: Mapping[str, float]
    ) -> Iterator[TrialShapes]:
        columns = feature.axis_starts(stretch)
        if not feature.axes.keys() <= given.keys():
            columns |= {name: np.array([given[name]]) for name in columns.keys() & given.keys()}
        feature.refuse_many(columns, stretch, MOST_SHIFTED)
        shapes = np.array(list(itertools.product(*columns.values()))).reshape(-1, len(columns))
        if feature.axes.keys() <= given.keys():
            shapes = np.vstack([shapes, [given[name] for name in columns]])
        # Filled up to rounds of one size: any other would be compiled, too.
        size = min(shared_count(len(shapes)), AT_ONCE)
        rounds = -(-len(shapes) // size)
        filled = shapes[np.minimum(np.arange(rounds * size), len(shapes) - 1)]
        alone = model.with_features({"one": feature})
        for start, some in enumerate(np.split(filled, rounds)):
            count = min(size, len(shapes) - start * size)
            at = dict(zip(columns, some.T, strict=True))
            signals = _signals(alone.filled, {k: as_real(v) for k, v in at.items()}, self.common())
            signals = np.asarray(alone.first(signals))[:count]
            shape = {name: column[:count] for name, column in at.items()}
            yield TrialShapes(shape, signals[:, 0], signals[:, 1:])

    # --- the fit ---

    def accepted(self, features: Features, fit: Fit) -> Fit:
        ends = {
            f"{name}.{part}"
            for name in features
            for part, least in NATURAL.items()
            if part in fit.value[name] and float(fit.value[name][part]) <= least * (1 + 1e-6)
        }
        left = tuple(name for name in fit.at_bound if name not in ends)
        return dataclasses.replace(fit, at_bound=left)

    def values(self, features: Features, params: Any) -> dict[str, float]:
        ((name, feature),) = features.items()
        read = super().values(features, params)
        if ANGLE in read:
            read |= {"angle_rad": float(angle_of(feature, params[name]))}
            del read[ANGLE]
        return read

    def report(self, features: Features, fit: Fit) -> dict[str, tuple[float, float]]:
        """As of any contact; of the angle, the size, with the standard error that its squared sine
        has. Errors of what is not distinct from zero are infinite: see `intervals`."""
        read, ((name, _),) = super().report(features, fit), features.items()
        indistinct = {part for part in NATURAL if part in read and not is_distinct(name, part, fit)}
        read |= {part: (read[part][0], np.inf) for part in indistinct}
        if ANGLE not in read:
            return read
        square, stderr = read.pop(ANGLE)
        angle = float(np.arcsin(np.sqrt(square)))
        return read | {"angle_rad": (angle, float(stderr / np.sin(2 * angle)))}

    def warnings(self, line: Line, features: Features, fit: Fit) -> tuple[str, ...]:
        if undetected_features(features, fit):
            return ()
        ((name, feature),) = features.items()
        found = [self._indistinct(name, part, fit) for part in NATURAL if part in feature.axes
                 and not is_distinct(name, part, fit)]  # fmt: skip
        return (*found, *self._beyond_hertz(line, features, fit))

    def _own_stderr(self, name: str, part: str, fit: Fit) -> float:
        """The standard error of a parameter if the rig's facts were known exactly."""
        beside = ("base_friction", "offset", *self.also)
        is_fact = np.array([not each.startswith((f"{name}.", *beside)) for each in fit.names])
        own, row = fit.covariance, list(fit.names).index(f"{name}.{part}")
        of_facts = own[row, is_fact]
        known = own[row, row] - of_facts @ np.linalg.solve(own[is_fact][:, is_fact], of_facts)
        return float(np.sqrt(max(known, 0.0)))

    def _indistinct(self, name: str, part: str, fit: Fit) -> str:
        most = self._most(name, part, fit)
        if part == ANGLE:
            degrees = np.degrees(np.arcsin(np.sqrt(min(most, 1.0))))
            return (
                f"The angle of {name} is not distinguished from 0: it is below {degrees:.2g} "
                f"degrees at 95 % confidence. Give feature.{name}.angle_deg where it is known: "
                "near 0 the radius depends on it."
            )
        known = self._own_stderr(name, part, fit)
        of_rig = (
            f" The rig's tolerances hide it: with all facts exact its standard error is "
            f"{quantity(known, 'm', 2)}. Calibrate the rig, or state smaller ones in "
            "recording.tolerance."
        )
        is_of_rig = float(fit.value[name][part]) > DISTINCT * known
        return (
            f"The data do not identify the radius of {name}: the contact is too narrow beside the "
            f"film's depth, and any radius up to {quantity(most, 'm')} explains them (95 % "
            f"confidence).{of_rig if is_of_rig else ' Raise the load or average scans.'}"
        )

    def _beyond_hertz(self, line: Line, features: Features, fit: Fit) -> tuple[str, ...]:
        """Warnings on a contact that is not narrow, or not the only one."""
        ((name, feature),) = features.items()
        if not is_distinct(name, "radius_m", fit):
            return ()
        params = jax.tree.map(as_real, fit.value)
        gap = self.profiles(line, features, params)[self.PROFILES.index("gap")]
        hertz = self.pressure(line, features, params)
        across = float(jnp.cos(angle_of(feature, params[name])) * hertz.half_width_m)
        found = []
        if across > MOST_SLOPE * float(params[name]["radius_m"]):
            found.append(
                f"The skin touches {name} over {2e6 * across:.3g} um, which is not narrow beside "
                "its radius: Hertz's pressure is not that of a contact so wide. Lower the load."
            )
        if float(jnp.min(gap)) < 0:
            found.append(
                f"Beside {name} the skin would reach the plate that it lies on, which then bears a "
                "part of the load: the radius is not that of the fit. Lower the load."
            )
        return tuple(found)

    def intervals(self, features: Features, fit: Fit) -> dict[str, tuple[float, float]]:
        """Those by profile likelihood of the radius and the angle where they are not distinct from
        zero: from zero to what the data exclude."""
        if undetected_features(features, fit):
            return {}
        ((name, feature),) = features.items()
        each = {}
        for part in (part for part in NATURAL if part in feature.axes):
            if is_distinct(name, part, fit):
                continue
            most = self._most(name, part, fit)
            if part == ANGLE:
                each["angle_rad"] = (0.0, float(np.arcsin(np.sqrt(min(most, 1.0)))))
            else:
                each[part] = (0.0, most)
        return each

    def _most(self, name: str, part: str, fit: Fit) -> float:
        """The greatest value of a parameter within its 90 % interval by profile likelihood."""
        own = f"{name}.{part}"
        try:
            return fit.profile([own])[own][1]
        except BadInput:
            stderr = float(fit.stderr[name][part])
            return float(fit.value[name][part]) + BAND_90 * stderr


def angle_of(feature: CylinderFeature, own: Mapping[str, Any]) -> Any:
    """The angle [rad], as it is known or fitted."""
    if feature.angle_deg is not None:
        return np.radians(feature.angle_deg)
    return jnp.arcsin(jnp.sqrt(own[ANGLE]))


def half_width(skin: Skin, load_N_per_m: Scalar, radius_m: Scalar) -> Scalar:
    """Half-width [m] of Hertz's pressure, of the variance that the circle's has.

    A circle rises more steeply than its parabola, of a = sqrt(4 F R/(pi E*)): the variance is that
    of a parabola of a radius less by F/(pi E*), to first order in a/R. Raises `BadInput` for a skin
    that is no half space.
    """
    half_space = (skin.skin if isinstance(skin, TurnedSkin) else skin).half_space
    if half_space is None:
        raise BadInput(
            "The pressure on a cylinder is Hertz's, on an elastic half space, and the skin is "
            f"another one ({skin.words}): leave out the effects that change the skin."
        )
    less_m = load_N_per_m / (jnp.pi * half_space.contact_modulus_Pa)
    return 2 * radius_m * jnp.sqrt(less_m / (radius_m + less_m))


def refuse_turned(skin: Skin) -> None:
    """Refuse a skin under features that are turned already."""
    refuse(
        isinstance(skin, TurnedSkin),
        "The line is that along the normal of turned features (oblique_features): give the "
        "cylinder's angle_deg as 0, or leave that effect out.",
    )


def is_distinct(name: str, part: str, fit: Fit) -> bool:
    """Whether a parameter is distinct from zero, which the signal is smooth about."""
    return bool(float(fit.value[name][part]) > DISTINCT * float(fit.stderr[name][part]))


def contact_of(features: Features) -> type[ContactLoading]:
    """How features of a surface touch the skin. Raises `BadInput` for a cylinder beside others: it
    is touched alone."""
    cylinders = [name for name, each in features.items() if isinstance(each, CylinderFeature)]
    refuse(
        bool(cylinders) and len(features) > 1,
        f"The features are {', '.join(features)}: a cylinder ({cylinders and cylinders[0]}) is "
        "touched alone, so fit it by itself.",
    )
    return CylinderLoading if cylinders else ContactLoading


@compiled
def _signals(model: Any, shapes, common) -> Float[Array, "start part e sample"]:
    """Signals of the model's only feature, without friction and what one unit of it adds."""
    ((name, _),) = model.features.items()
    rest = common | ({"offset": jnp.zeros(len(model.operator.field.transfer))}
                     if model.free_offset else {})  # fmt: skip

    def at(shape):
        without, with_one = (
            model(rest | {name: shape, "base_friction": as_real(one)}) for one in (0.0, 1.0)
        )
        return jnp.stack([without, with_one - without])

    return jax.lax.map(at, shapes)
