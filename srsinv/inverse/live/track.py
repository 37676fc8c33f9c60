"""The motion of a live inversion: where its passes begin and end."""

import dataclasses

import numpy as np
from jaxtyping import Float

from .settings import LiveSettings

TURN_DEPTHS = 0.5  # by which a motion goes back before it counts as a turn
START_CELLS = 0.25  # by which it has to move before its direction counts


@dataclasses.dataclass
class Track:
    """Where the motion is: its `direction`, 1 or -1, 0 before it has one; the `foremost` place in
    that direction, or where it starts [m]; and the time of the last sample [s]."""

    direction: int = 0
    foremost: float = np.nan
    time_s: float = -np.inf

    def stopped(self) -> "Track":
        """After a pass that has ended: the next sample has no direction yet."""
        return Track(time_s=self.time_s)

    def first_moving(
        self, settings: LiveSettings, x: Float[np.ndarray, " sample"], start: int
    ) -> int:
        """The sample, from `start` on, with which the motion gets a direction; as many as there are
        where it gets none."""
        if np.isnan(self.foremost):
            self.foremost = float(x[start])
        moved = np.abs(x[start:] - self.foremost) > START_CELLS * float(settings.cell_m)
        if not moved.any():
            return x.size
        first = start + int(np.argmax(moved))
        self.direction = 1 if x[first] > self.foremost else -1
        self.foremost = self.direction * float(x[first])
        return first

    def next_end(
        self, settings: LiveSettings, x: Float[np.ndarray, " sample"], start: int
    ) -> tuple[int, bool]:
        """The sample, from `start` on, before which the pass ends, and whether it does: the motion
        turns back, or jumps by more than the memory."""
        along = self.direction * x[start:]
        turn_m = TURN_DEPTHS * float(settings.depth_m)
        jump_m = float(settings.memory * settings.cell_m)
        least, most = float(along.min()), float(along.max())
        if max(most, self.foremost) - least <= turn_m and most - self.foremost <= jump_m:
            self.foremost = max(self.foremost, most)
            return x.size, False
        foremost = np.maximum.accumulate(np.append(self.foremost, along))
        is_back = foremost[1:] - along > turn_m
        ends = is_back | (along - foremost[:-1] > jump_m)
        if not ends.any():
            self.foremost = float(foremost[-1])
            return x.size, False
        first = int(np.argmax(ends))
        if is_back[first]:
            self.direction = -self.direction
        self.foremost = self.direction * float(x[start + first])
        return start + first, True
