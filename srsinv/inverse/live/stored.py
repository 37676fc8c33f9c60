"""A live inversion's state as arrays by name, and back.

Arrays of numbers alone: nothing that a file holds is executed.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import BadInput, echo, refuse
from .cells import CellStream, CellSums
from .noise_level import NoiseLevel
from .one_pass import LiveModel, OnePass, PassRecord
from .settings import LiveSettings
from .smoother import FixedLagSmoother
from .state_space import StateSpace
from .track import Track

VERSION = 1  # of the arrays' names and meanings
DIRECTIONS = ("back", "onwards")
# The arrays that have any length along these axes.
LENGTHS = {"stream.tail": 1, "stream.sums": 1} | {f"queue.{each}": 0 for each in CellSums._fields}


@dataclasses.dataclass
class LiveState:
    """The parts of a live inversion: what it was set to, the models of motion back and onwards, and
    where it is."""

    settings: LiveSettings
    models: tuple[LiveModel, LiveModel]
    track: Track
    level: NoiseLevel
    one_pass: OnePass

    def arrays(self) -> dict[str, np.ndarray]:
        """All of them by name."""
        one, arrays = self.one_pass, {"version": np.array(VERSION)}
        parts: dict[str, Any] = {
            "settings": self.settings,
            "track": self.track,
            "level": self.level,
            "stream": one.stream,
            "queue": _stacked(one.queue, self.settings),
            "smoother": one.smoother,
            "record": one.record,
        }
        for name, model in zip(DIRECTIONS, self.models, strict=True):
            parts[name] = model.space
        for name, part in parts.items():
            for field in _fields(type(part)):
                arrays[f"{name}.{field}"] = np.array(getattr(part, field))
        return arrays

    @classmethod
    def of(cls, arrays: Mapping[str, Any]) -> "LiveState":
        """The parts of these arrays. Raises `BadInput` where they are no state."""
        version = arrays.get("version")
        refuse(
            version is None or np.size(version) != 1 or np.ravel(version)[0] != VERSION,
            f"The state has the version {echo(version)}: give the arrays of Live.state(), of "
            f"version {VERSION}.",
        )
        settings = _part(LiveSettings, "settings", arrays)
        back, onwards = (
            LiveModel(settings, _part(StateSpace, name, arrays)) for name in DIRECTIONS
        )
        queue = _part(CellSums, "queue", arrays)
        one = OnePass(
            _part(CellStream, "stream", arrays),
            [CellSums(int(n), float(t), *sums) for n, t, *sums in zip(*queue, strict=True)],
            _part(FixedLagSmoother, "smoother", arrays),
            _part(PassRecord, "record", arrays),
        )
        level, track = _part(NoiseLevel, "level", arrays), _part(Track, "track", arrays)
        state = cls(settings, (back, onwards), track, level, one)
        state._check_shapes()
        return state

    def _check_shapes(self) -> None:
        """Refuse arrays whose shapes do not go together."""
        try:
            fresh = fresh_state(self.settings, self.models)
        except (ValueError, IndexError) as error:
            raise BadInput("The state's settings and models do not go together.") from error
        given = self.arrays()
        for name, wanted in fresh.arrays().items():
            shape, other = list(given[name].shape), list(wanted.shape)
            if name in LENGTHS and len(shape) == len(other):
                shape[LENGTHS[name]] = other[LENGTHS[name]]
            refuse(
                shape != other,
                f"{name} of the state has the shape {given[name].shape}: its other arrays ask for "
                f"{wanted.shape}.",
            )


def fresh_state(settings: LiveSettings, models: tuple[LiveModel, LiveModel]) -> LiveState:
    """The state before the first sample."""
    level = NoiseLevel.starting(settings.noise**2, settings.depth_cells)
    return LiveState(settings, models, Track(), level, OnePass.starting(models[True], True))


def _fields(kind: type) -> dict[str, Any]:
    """The fields of a part with their types."""
    if dataclasses.is_dataclass(kind):
        return {field.name: field.type for field in dataclasses.fields(kind)}
    return dict(kind.__annotations__)


def _stacked(queue: list[CellSums], settings: LiveSettings) -> CellSums:
    """Cells as one, whose arrays have a first axis of cells."""
    e, n = settings.elements, len(queue)
    shapes = [(n,), (n,), *4 * [(n, e)], (n, e, settings.nuisances), *2 * [(n, e)]]
    columns = zip(*queue, strict=True) if queue else shapes
    rows: Any = (
        np.array(each, float).reshape(shape) if queue else np.zeros(shape)
        for each, shape in zip(columns, shapes, strict=True)
    )
    return CellSums(*rows)


def _part(kind: type, name: str, arrays: Mapping[str, Any]) -> Any:
    """One part from its arrays."""
    values = {}
    for field, of_type in _fields(kind).items():
        key = f"{name}.{field}"
        refuse(key not in arrays, f"The state has no {key}: give all arrays of Live.state().")
        value = np.array(arrays[key])
        refuse(value.dtype.kind not in "biuf", f"{key} of the state is no array of numbers.")
        if of_type in (int, float) and kind is not CellSums:  # of which there are any number
            refuse(value.size != 1, f"{key} of the state has {value.size} numbers: give one.")
            value = of_type(value.item())
        values[field] = value
    return kind(**values)
