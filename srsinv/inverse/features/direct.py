"""Features of traction: they load the skin by themselves."""

from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...compiled import compiled
from ...errors import of_kind
from ...forward.feature import ScanExtent
from ...forward.scan import Motion
from ...forward.traction import Pressure
from ...grid import Line, as_real
from ...numerics import shared_count
from ..nonlinear import Fit
from .identifiability import limited_by_bounds, undetected_features
from .loading import Features, Loading, Normal, Range, Strengths, Traction, TrialShapes, turned


class DirectLoading(Loading):
    """The traction is the sum of the features'; periodic ones fade out towards the line's ends by
    `fade` (n,)."""

    fade: Float[Array, " n"]

    @classmethod
    def over(cls, line: Line, motion: Motion) -> "DirectLoading":
        """On a line with a margin beyond the scan."""
        return cls(_fade(line, motion))

    def tractions(
        self, line: Line, features: Features, params: Any, directions: tuple[bool, ...]
    ) -> list[Traction]:
        total = jnp.zeros((2, line.n))
        for name, feature in features.items():
            shape = _profile(feature, params[name]).cell_values(line)
            shape = shape * self.fade if feature.is_periodic else shape
            total = total + jnp.stack(amplitudes(feature, params[name]))[:, None] * shape[None]
        return [total if direction else turned(total) for direction in directions]

    def cell_traction(self, line: Line, features: Features, params: Any, onto: Line) -> Traction:
        total = jnp.zeros((2, onto.n))
        for name, feature in features.items():
            shape = _profile(feature, params[name]).cell_average(onto)
            if feature.is_periodic:
                shape = shape * jnp.interp(onto.x, line.x, self.fade)
            total = total + jnp.stack(amplitudes(feature, params[name]))[:, None] * shape
        return total

    def end(self, features: Features, params: Any) -> Float[Array, " 2"] | None:
        ends = [
            jnp.stack(amplitudes(feature, params[name]))
            for name, feature in features.items()
            if feature.is_semi_infinite
        ]
        return sum(ends[1:], ends[0]) if ends else None

    def trial_shapes(
        self, model: Any, feature: Any, stretch: ScanExtent, given: Mapping[str, float]
    ) -> Iterator[TrialShapes]:
        shapes = feature.starts(stretch)
        alone = model.with_features({"one": feature})
        signals = responses(alone, shapes)
        yield TrialShapes(shapes, np.zeros(signals.shape[2:]), signals)

    def begun(self, feature: Any) -> dict[str, float]:
        return dict.fromkeys(feature.linear, 0.0)

    def bounds(self, line: Line, features: Features, stretch: ScanExtent) -> dict[str, Range]:
        return {
            f"{name}.{part}": within
            for name, feature in features.items()
            for part, within in feature.ranges(stretch).items()
        }

    def priors(self, name: str, feature: Any, reach: Any, search: Strengths) -> dict[str, Normal]:
        return {
            f"{name}.{part}": (0.0, reach / top if top > 0 else 1.0)
            for part, top in zip(feature.linear, search.strongest(feature), strict=True)
        }

    def log_prior_ratio(
        self, feature: Any, own: Mapping[str, Any], search: Strengths
    ) -> Float[np.ndarray, " b"]:
        return np.log(search.relative_signal(feature, own)).sum(axis=1)

    def values(self, features: Features, params: Any) -> dict[str, float]:
        read: dict[str, float] = {}
        for name, feature in features.items():
            prefix, own = f"{name}_" if len(features) > 1 else "", params[name]
            listed = {part: float(own[part]) for part in (*feature.axes, feature.amplitude)}
            read |= {prefix + part: v for part, v in feature.canonical(listed).items()}
            if feature.friction is None and own[feature.amplitude] != 0:
                ratio = float(own[feature.shear]) / float(own[feature.amplitude])
                read[f"{prefix}friction"] = ratio
        return read

    def report(self, features: Features, fit: Fit) -> dict[str, tuple[float, float]]:
        """The shape, the amplitude and the friction of each feature.

        The error is infinite where the linearised one is not valid: for the shape and friction of
        an undetected feature (its amplitude has the prior's, as it could lie where its signal is
        weak); for an amplitude beside an undetected feature of the same kind; for parameters on a
        bound, and those strongly correlated with them.
        """
        read: dict[str, tuple[float, float]] = {}
        values = self.values(features, fit.value)
        missed, bound_limited = undetected_features(features, fit), limited_by_bounds(fit)
        for name, feature in features.items():
            prefix = f"{name}_" if len(features) > 1 else ""
            own, spread = fit.value[name], dict(fit.stderr[name])
            unsure = {part for part in own if f"{name}.{part}" in bound_limited}
            if name in missed:
                unsure |= {*feature.axes, "friction"}
                spread[feature.amplitude] = fit.prior_stderr[f"{name}.{feature.amplitude}"]
            if f"{name}.position_m" in fit.at_bound:  # a bound of the scan: it may lie outside
                unsure.add("friction")
            if any(type(features[other]) is type(feature) for other in missed if other != name):
                unsure.add(feature.amplitude)
            for part in (*feature.axes, feature.amplitude):
                error = np.inf if part in unsure else float(spread[part])
                read[prefix + part] = values[prefix + part], error
            if f"{prefix}friction" in values:
                stderr = np.inf if "friction" in unsure else friction_of(fit, name, feature)[1]
                read[f"{prefix}friction"] = values[f"{prefix}friction"], stderr
        return read


def _profile(feature: Any, shape: Mapping[str, Any]) -> Pressure:
    """The feature's profile, which may be a stranger's."""
    what = f"what {type(feature).__name__}.profile gives"
    return of_kind(what, feature.profile(shape), Pressure, "a pressure, as UniformStrip(1.0, 2e-3)")


def amplitudes(feature: Any, own: Mapping[str, Any]) -> tuple[Array, Array]:
    """Of p and of q."""
    p = jnp.asarray(own[feature.amplitude])
    q = own[feature.shear] if feature.friction is None else feature.friction * p
    return p, jnp.asarray(q)


@compiled
def _fade(line: Line, motion: Motion) -> Float[Array, " n"]:
    """One over the scan and half its margins, falling to zero at the line's ends as a cosine."""
    x, low, high = line.x, jnp.min(motion.position_m), jnp.max(motion.position_m)
    outside = jnp.maximum(low - x, x - high) / jnp.maximum(low - x[0], line.cell_m)
    return 0.5 * (1 + jnp.cos(jnp.pi * jnp.clip(2 * outside - 1, 0.0, 1.0)))


def responses(model: Any, shapes) -> Float[np.ndarray, "start a e sample"]:
    """Signals of every unit amplitude of the model's only feature, for each shape."""
    count = len(next(iter(shapes.values())))
    # Filled up with the last one: another number of shapes would be compiled, too.
    which = np.minimum(np.arange(shared_count(count)), count - 1)
    filled = {part: as_real(np.asarray(values)[which]) for part, values in shapes.items()}
    return np.asarray(model.first(_responses(model.filled, filled)))[:count]


@compiled
def _responses(model: Any, shapes) -> Float[Array, "start a e sample"]:
    ((name, feature),) = model.features.items()
    elements = model.operator.field.transfer.shape[0]
    rest = {"offset": jnp.zeros(elements)} if model.free_offset else {}

    def of(shape, one: str):
        own = {part: as_real(float(part == one)) for part in feature.linear}
        return model({name: shape | own} | rest)

    def at(shape):
        return jnp.stack([of(shape, one) for one in feature.linear])

    return jax.lax.map(at, shapes, batch_size=64)


def friction_of(fit: Fit, name: str, feature: Any) -> tuple[float, float]:
    """mu, the ratio of the two amplitudes, and its standard error to first order."""
    return fit.ratio(f"{name}.{feature.shear}", f"{name}.{feature.amplitude}")
