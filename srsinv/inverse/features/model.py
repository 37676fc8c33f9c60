"""Forward model of features: parameters to the signal of a sensor along a motion."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ... import resolution
from ...compiled import compiled
from ...errors import refuse
from ...forward.contact import refuse_both_ways
from ...forward.feature import ScanExtent
from ...forward.operator import MotionOperator
from ...forward.scan import Motion
from ...forward.sensor import Sensor
from ...grid import Line, Open, Periodic, as_real
from ...numerics import fast_length, shared_count
from ..gridding.cells import Window, check_cells
from ..rig.error import UncertainSetup
from ..rig.setup import OF_CONTACT, Setup
from .contact import ContactLoading
from .direct import DirectLoading
from .loading import Features, Loading, turned
from .uncertain import UncertainOperator

FAR_M = 1e3  # how far a step goes on
BLOCK = 256  # cells come in multiples of it: the contact starts on so much wider cells


class FeatureModel(eqx.Module):
    """Parameters of features to the signal (element, sample) of a sensor along a motion.

    `loading` says how they load the skin. Parameters are a tree: each feature's by its name, those
    of the loading, and where each element has an unknown constant `offset`. Where features are
    searched is no part of the model: one program serves every range. `nuisance` (j, e, sample) are
    signals of what is not known of the rig, each times a number of `calibration` (j,); or else
    these are how far the facts of the rig are off, which `uncertain` makes the operator of.
    `count`: of the motion's samples the signal is of so many, the first; None: of all. `cells`: so
    many of the line's, the first, are the scan with its margins; None: all.
    """

    operator: MotionOperator
    loading: Loading
    features: dict[str, Any]
    free_offset: bool = eqx.field(static=True)
    nuisance: Float[Array, "j e sample"] | None = None
    uncertain: UncertainOperator | None = None
    count: int | None = eqx.field(static=True, default=None)
    cells: int | None = eqx.field(static=True, default=None)

    @classmethod
    def along(
        cls, sensor: Sensor, motion: Motion, cell_m: float | None = None, is_shared: bool = False
    ) -> "FeatureModel":
        """The model of features of traction, without any of them.

        The traction lies on an open line with fine cells and a margin beyond the scan; a
        semi-infinite feature goes on beyond the line's end, and a periodic one fades out towards
        both ends. `cell_m` [m]: None is fine enough for a signal right to 1e-5 of its peak.
        `is_shared`: whether the line goes on up to a number of cells that many lengths share.
        """
        own = line = line_under(sensor, motion, cell_m)
        if is_shared:
            line = Open(shared_count(own.n), float(own.cell_m), float(own.start_m))
        operator = operator_along(sensor, line, motion, FAR_M, motion.directions)
        loading = DirectLoading.over(line, motion)
        is_free = sensor.amplifier.offset is None
        return cls(operator, loading, {}, is_free, cells=None if own.n == line.n else own.n)

    @classmethod
    def on_window(
        cls,
        sensor: Sensor,
        motion: Motion,
        window: Window,
        cell_m: float,
        nominal_pressure_Pa: float,
        also: tuple[str, ...] = (),
        kind: type[Open] | type[Periodic] = Open,
        contact: type[ContactLoading] = ContactLoading,
    ) -> "FeatureModel":
        """The model of features of a surface on the bare plate, on cells of at most `cell_m`.

        The surface repeats with the window. Beyond an open line the traction is that of the plate,
        to which a rate has no response; on a periodic one, quicker to set up, everything repeats.
        `also`: see [`ContactLoading`][]. `contact`: how the features touch the skin. Raises
        `BadInput` for a window that does not hold the scan.
        """
        x = np.asarray(motion.position_m)
        refuse(
            not (window.start_m <= x.min() and x.max() <= window.end_m),
            f"The contact window from {window.start_m:.6g} m to {window.end_m:.6g} m does "
            f"not contain the scan from {x.min():.6g} m to {x.max():.6g} m: give "
            "recording.contact_window_m as [start, end] around it.",
        )
        check_cells("The contact window", window.length_m, cell_m)
        blocks = int(np.ceil(window.length_m / cell_m / BLOCK))
        n = BLOCK * fast_length(max(blocks, 1))
        cell = window.length_m / n
        line, directions = kind(n, cell, window.start_m + cell / 2), motion.directions
        if len(directions) > 1:
            refuse_both_ways(sensor.skin)
        operator = operator_along(sensor, line, motion, None, directions)
        loading = contact(sensor, motion, sensor.depth_m, nominal_pressure_Pa, also)
        return cls(operator, loading, {}, sensor.amplifier.offset is None)

    def with_features(self, features: Features) -> "FeatureModel":
        """The same sensor and motion with these features in place of its own."""
        anywhere = {name: feature.anywhere for name, feature in features.items()}
        return dataclasses.replace(self, features=anywhere)

    def with_nuisance(self, columns: Float[np.ndarray, "j e sample"]) -> "FeatureModel":
        """The same beside signals of what is not known of the rig."""
        beyond = ((0, 0), (0, 0), (0, self.samples - columns.shape[-1]))
        return dataclasses.replace(self, nuisance=as_real(np.pad(columns, beyond)))

    @property
    def filled(self) -> "FeatureModel":
        """The model of all samples of its motion and cells of its line: programs of it serve many
        lengths."""
        if self.count is None and self.cells is None:
            return self
        return dataclasses.replace(self, count=None, cells=None)

    @property
    def samples(self) -> int:
        """The number of its motion's samples."""
        return int(self.operator.gain.size)

    def first(self, signals: Any) -> Any:
        """Those of the model's samples, along the last axis, of signals at all of its motion's."""
        if self.count is None:
            return signals
        if isinstance(signals, Tracer):
            return signals[..., : self.count]
        # By jax each length would be compiled.
        return jax.device_put(np.asarray(signals)[..., : self.count])

    @property
    def line(self) -> Line:
        """The cells of the traction."""
        return self.operator.line

    @property
    def scanned_line(self) -> Line:
        """Those of the scan with its margins."""
        whole = self.line
        if self.cells is None:
            return whole
        return type(whole)(self.cells, whole.cell_m, whole.start_m)

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter linearly."""
        own = [f"{name}.{part}" for name, f in self.features.items() for part in f.linear]
        rig = () if self.nuisance is None else ("calibration",)
        return (*self.loading.LINEAR, *own, *rig, *(("offset",) if self.free_offset else ()))

    @property
    def may_hold(self) -> tuple[str, ...]:
        """Names of parameters that a fit may hold: those of the rig's facts."""
        return () if self.uncertain is None else ("calibration",)

    @property
    def steps(self) -> dict[str, float]:
        """Steps for central differences, by parameter, where derivatives need them."""
        return self.loading.steps(self.line, self.features)

    def with_setup(self, setup: Setup, motion: Motion) -> "FeatureModel":
        """The same features and line under another setup of the same films' number; `motion` is
        the one that is stated."""
        operator = _under(self.operator, setup, motion)
        loading = self.loading.with_operator_of(setup.sensor, setup.motion(motion))
        return dataclasses.replace(self, operator=operator, loading=loading)

    def under(self, sensor: Sensor, motion: Motion) -> "FeatureModel":
        """The same features and line under another sensor of as many films, which jax may trace;
        `motion`: the model's own."""
        operator = _under(self.operator, Setup(sensor), motion)
        operator = dataclasses.replace(operator, line=self.line)  # which stays known
        loading, is_free = self.loading.at(sensor, motion), sensor.amplifier.offset is None
        return dataclasses.replace(self, operator=operator, loading=loading, free_offset=is_free)

    def at_facts(self, params: Any) -> tuple["FeatureModel", Any]:
        """The model and the parameters with the facts of the rig that `calibration` stands for."""
        if self.uncertain is None:
            return self, params
        off, known = params["calibration"], self.uncertain.setup
        setup = known(off)
        here = dataclasses.replace(
            self,
            operator=self.uncertain(self.operator, off),
            loading=self.loading.at(setup.sensor, setup.motion(known.motion)),
            uncertain=None,
        )
        return here, self.loading.params_at(self.features, params, setup)

    def about(self, known: UncertainSetup, off: Float[np.ndarray, " j"]) -> "FeatureModel":
        """The same features where the facts of the rig are numbers `off` from what is stated, and
        may be off further."""
        still = {*OF_CONTACT} | ({"speed"} if self.operator.end is None else set())
        moving = known.directions_of(frozenset(still))
        uncertain, operator = _uncertain_operator(self.operator, known, as_real(off), moving)
        return dataclasses.replace(self, operator=operator, uncertain=uncertain)

    def on_finer_cells(
        self, params: Any, sensor: Sensor, motion: Motion
    ) -> Float[np.ndarray, "e sample"]:
        """The signal of features of a surface on cells half as wide; `sensor` and `motion` are
        those that are stated, the latter with all samples of the model's."""
        return np.asarray(self.first(self.filled._on_finer_cells(params, sensor, motion)))

    @compiled
    def _on_finer_cells(self, params: Any, sensor: Sensor, motion: Motion):
        here, own = self.at_facts(params)
        known = None if self.uncertain is None else self.uncertain.setup
        setup = Setup(sensor) if known is None else known(params["calibration"])
        line, directions = self.line, self.operator.directions
        finer = type(line)(2 * line.n, line.cell_m / 2, line.start_m - line.cell_m / 4)
        operator = operator_along(setup.sensor, finer, setup.motion(motion), None, directions)
        return dataclasses.replace(here, operator=operator)._signal(own)

    def traction(self, params: Any) -> Float[Array, "2 n"]:
        """p and q [Pa] on the line beyond their background, while sliding towards +x."""
        return self.filled._traction(params)

    @compiled
    def _traction(self, params: Any) -> Float[Array, "2 n"]:
        here, params = self.at_facts(params)
        return here.loading.tractions(self.line, self.features, params, (True,))[0]

    def profiles(self, params: Any) -> Float[Array, "profile n"]:
        """What acts along the line while sliding towards +x: see `loading.PROFILES`."""
        here, params = self.at_facts(params)
        return here.loading.profiles(self.line, self.features, params)

    def cell_traction(self, params: Any, line: Line) -> Float[Array, "2 m"]:
        """Averages of p and q [Pa] over the cells of any line, while sliding towards +x."""
        here, params = self.at_facts(params)
        return here.loading.cell_traction(self.line, self.features, params, line)

    def tractions(self, params: Any) -> list[Float[Array, "2 n"]]:
        """p and q [Pa] on the line for each way of the motion."""
        return self.loading.tractions(self.line, self.features, params, self.operator.directions)

    def __call__(self, params: Any) -> Float[Array, "e sample"]:
        # Python's numbers would be compiled in.
        return self.first(self.filled._signal(jax.tree.map(as_real, params)))

    @compiled
    def _signal(self, params: Any) -> Float[Array, "e sample"]:
        if self.uncertain is not None:
            here, params = self.at_facts(params)
            return here._signal(params)
        operator = self.loading.operator(self.operator, self.features, params)
        end, gain = self.loading.end(self.features, params), self.loading.gain(params)
        tractions, directions = _stacked(self.tractions(params)), self.operator.directions
        if end is not None:
            end = _stacked([end if onwards else turned(end) for onwards in directions])
        signal = operator(tractions, end)
        signal = signal if gain is None else gain * signal
        if self.nuisance is not None:
            signal = signal + jnp.tensordot(params["calibration"], self.nuisance, 1)
        return signal + params["offset"][:, None] if self.free_offset else signal


def _stacked(directions: list[Float[Array, "2 *n"]]) -> Float[Array, "..."]:
    return jnp.stack(directions) if len(directions) > 1 else directions[0]


@compiled
def _uncertain_operator(
    operator: MotionOperator,
    known: UncertainSetup,
    off: Float[Array, " j"],
    moving: tuple[int, ...],
) -> tuple[UncertainOperator, MotionOperator]:
    return UncertainOperator.about(
        known, off, moving, lambda setup: _under(operator, setup, known.motion)
    )


def _under(operator: MotionOperator, setup: Setup, motion: Motion) -> MotionOperator:
    """The operator of another setup on the same line."""
    reach = None if operator.end is None else FAR_M
    return operator_along(
        setup.sensor, operator.line, setup.motion(motion), reach, operator.directions
    )


@compiled
def operator_along(
    sensor: Sensor, line: Line, motion: Motion, reach_m: float | None, directions: tuple[bool, ...]
) -> MotionOperator:
    """[`Sensor.operator_along`][] as one program."""
    return sensor.operator_along(line, motion, reach_m, directions)


def line_under(sensor: Sensor, motion: Motion, cell_m: float | None) -> Open:
    """The open line that features of traction lie on: fine cells, and a margin at both ends."""
    depth = float(sensor.depth_m)
    x = np.asarray(motion.position_m)
    cell = resolution.cell_m("load", depth) if cell_m is None else cell_m
    check_cells("The scan", float(np.ptp(x)), cell)
    margin = resolution.margin_m("fade", depth)
    start = float(x.min()) - margin
    n = int(np.ceil((float(x.max()) + margin - start) / cell)) + 1
    return Open(n, cell, start)


def scan_extent(sensor: Sensor, motion: Motion) -> ScanExtent:
    """Where the motion has been."""
    x = np.asarray(motion.position_m)
    return ScanExtent(float(x.min()), float(x.max()), float(sensor.depth_m))


def filled_up(motion: Motion) -> Motion:
    """The motion, held at its end up to a number of samples that many lengths share."""
    count = motion.time_s.size
    return motion if shared_count(count) == count else motion.held(shared_count(count))


def filled_model(motion: Motion, make: Callable[[Motion], FeatureModel]) -> FeatureModel:
    """The model that `make` gives along a motion, of programs that many lengths share."""
    model, count = make(filled_up(motion)), int(motion.time_s.size)
    return model if model.samples == count else dataclasses.replace(model, count=count)
