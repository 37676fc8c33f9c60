"""Live inversion: p and q while the finger slides, with a fixed delay.

Samples are gathered on cells (cells.py), and each finished cell passes a Kalman filter with a
fixed-lag smoother (smoother.py), whose model is made once from sensor and prior (state_space.py).
The noise level follows the signal (noise_level.py). What is called for each sample is numpy alone.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...errors import BadInput, mapping, of_kind, refuse
from ...forward.sensor import Sensor
from .covariance import joint_covariance
from .one_pass import FinishedCell, LiveModel
from .settings import LiveSettings
from .state_space import StateSpace, state_space
from .stored import LiveState, fresh_state

FARTHEST = 1e10  # s or m: beyond, times and positions have too few digits


class LiveCells(NamedTuple):
    """Cells that a live inversion has finished, in the order of the motion.

    - `x_m` (n,) [m]: their centres. `p_Pa`, `q_Pa` (n,) [Pa]: means of pressure and shear over
      each, with their standard errors `p_stderr_Pa`, `q_stderr_Pa` (n,) [Pa].
    - `noise` (e, n): the rms of white noise per sample that was assumed there, in the signal's
      unit; `is_settling` (n,): whether this level was still settling.
    - `pass_number` (n,): of the pass, from 0.
    """

    x_m: Float[np.ndarray, " n"]
    p_Pa: Float[np.ndarray, " n"]
    q_Pa: Float[np.ndarray, " n"]
    p_stderr_Pa: Float[np.ndarray, " n"]
    q_stderr_Pa: Float[np.ndarray, " n"]
    noise: Float[np.ndarray, "e n"]
    is_settling: Bool[np.ndarray, " n"]
    pass_number: Int[np.ndarray, " n"]

    @classmethod
    def joined(cls, parts: Sequence["LiveCells"]) -> "LiveCells":
        """Several in a row, at least one. Raises `BadInput` for none."""
        refuse(not parts, "There are no cells to join: give what push and finish returned.")
        return cls(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))

    @property
    def n(self) -> int:
        """The number of cells."""
        return self.x_m.size


class Live:
    """Live inversion: p and q along x with a fixed delay, while samples arrive.

    - `sensor`: the [`Sensor`][srsinv.Sensor]. `prior`: a method whose levels are given, as
      `srsinv.Wiener()`, one spectrum for p and q alike, or what
      `srsinv.Tikhonov().prior_fixed_on(problem)` chose on an earlier recording.
    - `noise`: "adaptive" follows the noise level; else the rms of white noise per sample, one for
      all elements or one for each, in the signal's unit.
    - `lag_m` [m]: how far behind the sensor a cell is finished. The delay is a cell more, as it
      has to end.
    - `cell_m` [m]: the width of the cells; None: an eighth of the film's depth. `memory_m` [m]:
      how far apart traction and signal still act on each other in the model; None: 64 depths.
    - `friction`: mu of q = mu p while sliding towards +x; None leaves p and q apart.
    - `nominal_pressure_Pa` [Pa]: the pressure far from features, which a rate signal does not show.
    - `drift`: rms after a second of each signal's random walk, in its unit; `mains_Hz` (m,) [Hz]:
      lines of mains on the signals.
    - `speed_m_per_s` [m/s]: at which filters of the sensor act, where it has any.

    `push` takes samples and returns the cells that they finish. Memory does not grow. A motion that
    turns back by half a depth closes its pass and starts another. q is the shear that acts on the
    skin towards +x in that pass.

    Raises `BadInput` for values out of range, for a prior whose levels are not given, for an
    amplifier whose gain is not linear in the speed, and for one element without `friction`.

    The method is a Kalman filter with a fixed-lag smoother (Rauch, Tung and Striebel 1965) on a
    state-space model that is realised from the covariances of sensor and prior (Akaike 1975).
    """

    def __init__(
        self,
        sensor: Sensor,
        prior: Any,
        *,
        noise: Any = "adaptive",
        lag_m: float,
        cell_m: float | None = None,
        memory_m: float | None = None,
        friction: float | None = None,
        nominal_pressure_Pa: float = 0.0,
        drift: Any = 0.0,
        mains_Hz: Sequence[float] = (),
        speed_m_per_s: float | None = None,
    ):
        of_kind("sensor", sensor, Sensor, "a Sensor")
        settings = LiveSettings.of(
            sensor, noise=noise, lag_m=lag_m, cell_m=cell_m, memory_m=memory_m, friction=friction,
            nominal_pressure_Pa=nominal_pressure_Pa, drift=drift, mains_Hz=mains_Hz,
        )  # fmt: skip
        # The model learns from twice the memory, so that what is left out of it is small there.
        memory = 2 * int(settings.memory)

        def space(is_onwards: bool) -> StateSpace:
            covariance = joint_covariance(
                sensor, prior, float(settings.cell_m), 2 * memory,
                is_onwards=is_onwards, friction=friction, speed_m_per_s=speed_m_per_s,
            )  # fmt: skip
            return state_space(covariance, memory, settings.depth_cells)

        onwards = space(is_onwards=True)
        # Friction and filters turn with the motion.
        is_alike = friction is None and not sensor.filters
        back = onwards.reversed() if is_alike else space(is_onwards=False)
        models = LiveModel(settings, back), LiveModel(settings, onwards)
        self._state = fresh_state(settings, models)

    def push(
        self, time_s: Any, position_m: Any, signal: Any, speed_m_per_s: Any = None
    ) -> LiveCells:
        """Take further samples, and return the cells that they finish.

        - `time_s` (n,) [s]: increasing, also from call to call. `position_m` (n,) [m].
        - `signal` (e, n): as recorded, in the amplifier's unit; NaN marks a missing sample.
        - `speed_m_per_s` (n,) [m/s]: where it was measured; None takes it from the positions.

        One sample may be given as numbers and a signal (e,). Raises `BadInput` for other shapes,
        times that do not increase, and values that are not finite; nothing is taken then.
        """
        rows, state = self._rows(time_s, position_m, signal, speed_m_per_s), self._state
        x, track, start, finished = rows[1], state.track, 0, []
        while start < x.size:
            if not track.direction:
                start = track.first_moving(state.settings, x, start)
                if track.direction:
                    finished += self._ended(track.direction > 0)
                continue
            stop, ends = track.next_end(state.settings, x, start)
            finished += state.one_pass.push(self._model, state.level, rows[:, start:stop])
            start = stop
            if ends:
                finished += self._ended(track.direction > 0)
        if x.size:
            track.time_s = float(rows[0, -1])
        return self._cells(finished)

    def finish(self) -> LiveCells:
        """End the pass, and return the cells that are left, with what is known of them.

        Further samples start a new pass."""
        finished = self._ended(is_onwards=True)
        self._state.track = self._state.track.stopped()
        return self._cells(finished)

    def __repr__(self) -> str:
        settings = self._state.settings
        lag_m = float(settings.lag * settings.cell_m)
        return (
            f"<Live: {settings.elements} elements, cells of {self.cell_m:.4g} m, "
            f"lag {lag_m:.4g} m, {self._model.space.states} states>"
        )

    @property
    def cell_m(self) -> float:
        """The width of the cells [m]."""
        return float(self._state.settings.cell_m)

    @property
    def memory_m(self) -> float:
        """How far apart traction and signal act on each other in the model [m]."""
        return float(self._state.settings.memory) * self.cell_m

    def with_lag(self, lag_m: float) -> "Live":
        """The same live inversion with another lag, `lag_m` [m], before its first sample."""
        state = self._state
        settings = state.settings.with_lag(lag_m)
        back, onwards = (LiveModel(settings, model.space) for model in state.models)
        live = object.__new__(Live)
        live._state = fresh_state(settings, (back, onwards))
        return live

    def state(self) -> dict[str, np.ndarray]:
        """All that is needed to go on later, as arrays by name: `numpy.savez(path, **state)`
        stores them, and `Live.from_state(numpy.load(path))` goes on."""
        return self._state.arrays()

    @classmethod
    def from_state(cls, state: Mapping[str, np.ndarray]) -> "Live":
        """The live inversion whose [`state`][srsinv.Live.state] it was; it needs neither the sensor
        nor the prior.

        - `state`: the arrays by name, as `state` gave them or as `numpy.load` reads them.

        Raises `BadInput` for what is no state.
        """
        state = mapping("state", state, "the arrays by name, as numpy.load(path) reads them")
        live = object.__new__(cls)
        live._state = LiveState.of(state)
        return live

    @property
    def _model(self) -> LiveModel:
        """The model of this pass."""
        return self._state.models[self._state.one_pass.stream.direction > 0]

    def _ended(self, is_onwards: bool) -> list[FinishedCell]:
        """What the end of the pass finishes; one in this direction begins."""
        state, one = self._state, self._state.one_pass
        finished = one.close(self._model, state.level)
        state.one_pass = one.following(state.models[is_onwards], is_onwards)
        return finished

    def _cells(self, finished: list[FinishedCell]) -> LiveCells:
        """All finished cells of a call."""
        width = 7 + self._state.settings.elements
        if not finished:  # as mostly
            none = np.zeros(0)
            return LiveCells(none, none, none, none, none, np.zeros((width - 7, 0)), none > 0,
                             none.astype(int))  # fmt: skip
        columns = np.array(finished).reshape(-1, width).T
        x, p, q, p_stderr, q_stderr, number, is_settling = columns[:7]
        return LiveCells(
            x, p, q, p_stderr, q_stderr, columns[7:], is_settling > 0, number.astype(int)
        )

    def _rows(
        self, time_s: Any, position_m: Any, signal: Any, speed_m_per_s: Any
    ) -> Float[np.ndarray, "row n"]:
        """The samples as `CellStream` takes them."""
        settings = self._state.settings
        e, last_s = settings.elements, self._state.track.time_s
        given = [np.asarray(each, float) for each in (time_s, position_m, signal)]
        if given[0].ndim == 0:
            given = [each[..., None] for each in given]
        (time, x, values), n = given, given[0].size
        speed = None if speed_m_per_s is None else np.asarray(speed_m_per_s, float).reshape(-1)
        if not (
            time.shape == x.shape == (n,)
            and values.shape == (e, n)
            and (speed is None or speed.shape == (n,))
        ):
            raise BadInput(
                f"time_s, position_m and signal have the shapes {time.shape}, {x.shape} and "
                f"{values.shape}: give (n,), (n,) and ({e}, n), and a speed (n,)."
            )
        rows = np.empty((3 + e + settings.nuisances, n))
        rows[0], rows[1], rows[2] = time, x, np.nan if speed is None else speed
        np.subtract(values, settings.offset[:, None], out=rows[3 : 3 + e])
        if not (np.abs(rows[:2]) < FARTHEST).all() or np.isinf(rows[2 : 3 + e]).any():
            raise BadInput(
                "Times, positions, speeds or signals are not finite, or far too large: leave these "
                "samples out, or give NaN for a missing signal."
            )
        if n and (time[0] <= last_s or (n > 1 and (time[1:] <= time[:-1]).any())):
            late = np.diff(time, prepend=last_s) <= 0
            raise BadInput(
                f"time_s is {time[np.argmax(late)]:.9g} s, not after the sample before it: leave "
                "the sample out."
            )
        if settings.nuisances:
            phases = 2 * np.pi * settings.mains_Hz[:, None] * time
            m = settings.mains_Hz.size
            rows[3 + e : rows.shape[0] - 2 * m] = 1.0
            rows[rows.shape[0] - 2 * m :] = np.concatenate([np.cos(phases), np.sin(phases)])
        return rows
