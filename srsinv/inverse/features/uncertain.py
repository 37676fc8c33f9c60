"""The operator of a rig whose facts are known to within tolerances, as a function of these.

Facts that multiply the signal, or move it along the scan, are followed exactly, for with the
features' amplitudes and places they may be off together, far beyond what is linear: gains and the
speed. The transfer functions are linear in small changes of depth, angles, offsets, strips' widths
and Poisson's ratio, about values that a fit finds in rounds.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ...forward.operator import MotionOperator, PositionInterpolation
from ..rig.error import UncertainSetup
from ..rig.setup import Setup


class UncertainOperator(eqx.Module):
    """The operator at numbers (j,) of variance one, by which the facts are off.

    - `setup`: the facts; `at` (j,): where the transfer functions `transfers` (d, e, c, k) and the
      responses `ends` (d, e, c, sample) are derivatives, gains aside, by those of the numbers that
      move them, `moving` (d,).
    """

    setup: UncertainSetup
    at: Float[Array, " j"]
    moving: tuple[int, ...] = eqx.field(static=True)
    transfers: Complex[Array, "d e c k"]
    ends: Float[Array, "d e c sample"] | None

    @classmethod
    def about(
        cls,
        setup: UncertainSetup,
        at: Float[Array, " j"],
        moving: tuple[int, ...],
        operator_of: Callable[[Setup], MotionOperator],
    ) -> tuple["UncertainOperator", MotionOperator]:
        """That about numbers `at`, of which those in `moving` move the operator, and the operator
        there, gains aside; `operator_of` gives that of any setup. To be compiled: every step is the
        same program."""
        bare = setup.without_gains()

        def change(step):
            above, below = (operator_of(bare(at + sign * step)) for sign in (1, -1))
            transfer = (above.field.transfer - below.field.transfer) / 2
            if above.end is None or below.end is None:
                return transfer, None
            return transfer, (above.end - below.end) / 2

        steps = jnp.eye(at.size, dtype=at.dtype)[np.array(moving, int)]
        transfers, ends = jax.lax.map(change, steps)
        return cls(setup, at, moving, transfers, ends), operator_of(bare(at))

    def __call__(self, here: MotionOperator, off: Float[Array, " j"]) -> MotionOperator:
        """The operator at these numbers, from the one at `at`."""
        beside = (off - self.at)[np.array(self.moving, int)]
        gains = self.setup.gains(off)[:, None, None]
        transfer = gains * (here.field.transfer + jnp.tensordot(beside, self.transfers, 1))
        end = here.end
        if end is not None and self.ends is not None:
            end = gains * (end + jnp.tensordot(beside, self.ends, 1))
        motion = self.setup(off).motion(self.setup.motion)
        amplifier = self.setup.sensor.amplifier
        return dataclasses.replace(
            here,
            field=dataclasses.replace(here.field, transfer=transfer),
            interpolation=PositionInterpolation(here.line, motion.position_m),
            gain=amplifier.at_speed(motion.speed_m_per_s),
            end=end,
        )
