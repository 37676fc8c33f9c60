"""What makes numbers of the signal: when it is sampled on the way, and how samples are kept."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..grid import Line, Periodic, as_real
from .drift import SinusoidalLoad
from .sampling import SampleConversion
from .scan import ConstantSpeed, Motion
from .speed_profile import SpeedProfile, paced


class Recorder(eqx.Module):
    """The recording side of a scenario; with nothing named it takes one sample a cell.

    - `sample_rate_hz`: None for what the line's cells ask for; `speed_profiles`: how the motion
      departs from constant speed; `drift`: of the load.
    - `conversions`: what is done to every sample alone, in their order.
    """

    sample_rate_hz: float | None = eqx.field(static=True, default=None)
    speed_profiles: tuple[SpeedProfile, ...] = ()
    drift: SinusoidalLoad | None = None
    conversions: tuple[SampleConversion, ...] = ()

    @property
    def samples_in_time(self) -> bool:
        """Whether samples differ from those of the line at constant speed."""
        return (
            self.sample_rate_hz is not None or bool(self.speed_profiles) or self.drift is not None
        )

    def rate_hz(self, fine: Line, scan: ConstantSpeed) -> float:
        """Samples a second: as asked, or once a cell of the finer line."""
        return self.sample_rate_hz or float(scan.sample_rate_hz(fine))

    def motion(self, line: Line, fine: Line, scan: ConstantSpeed) -> Motion:
        """The motion over all of `line`, sampled as asked, or once a cell of the finer line.

        A periodic line is slid over from edge to edge; an open one from its first position to the
        last of the finer one's.
        """
        rate = self.rate_hz(fine, scan)
        speed, cell = float(scan.speed_m_per_s), float(line.cell_m)
        if isinstance(line, Periodic):
            start, length = float(line.start_m) - cell / 2, line.n * cell
            return paced(start, length, speed, rate, self.speed_profiles)
        length = float(fine.x[-1] - line.start_m)
        motion = paced(float(line.start_m), length, speed, rate, self.speed_profiles)
        # The last sample is beyond the end.
        return jax.tree.map(lambda column: column[:-1], motion)

    def valid(self, signal: Float[Array, "e n"]) -> Bool[Array, "e n"]:
        """Which samples still tell the signal once they are converted."""
        valid = jnp.ones(signal.shape, bool)
        for conversion in self.conversions:
            valid = valid & conversion.valid(signal)
            signal = conversion.convert(signal)
        return valid

    def convert(self, signal: Float[Array, "e n"]) -> Float[Array, "e n"]:
        """The samples as they are kept."""
        for conversion in self.conversions:
            signal = conversion.convert(signal)
        return signal

    @property
    def variance(self) -> Float[Array, ""]:
        """Of the noise that the conversion adds, in signal units squared."""
        return sum((c.variance() for c in self.conversions), as_real(0.0))
