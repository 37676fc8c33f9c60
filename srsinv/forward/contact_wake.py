"""Friction of a viscoelastic skin that a periodic window leaves out.

Behind a load such a skin recovers over the length u tau', tau' = (1 + f) tau for one mode. Where
everything repeats with a window L that is not far longer, a contact meets its own wake, which
tilts the skin against the motion, and part of the work of sliding is missing. Per unit length that
work is

    F = -(1/pi) int_0^inf k Im C(k) |p(k)|^2 dk,

of which the window has the sum over its harmonics k = 2 pi n/L. With |p(k)|^2 that of the nearest
harmonic from n = 1 on, the difference needs the compliance alone. For a load P that is narrow
beside L, on a half space with one mode, it is

    2 P^2/(pi E*) f/(1 + f)/(u tau') [Re psi(1 + i b) - ln b],  b = L/(2 pi u tau'),

psi the digamma function: pi^2/3 (u tau'/L)^2 in the bracket where L is long, so that it falls by
a power and no exponential.

Where the skin lies on a plate at the window's ends, what a shape adds to the load it takes from the
plate about it: p(k) goes to zero with k, and little is missing (below 2 % with a wake of 1.6
windows under a ridge that lifts a third of the skin). There the window is not extended.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..compiled import compiled
from ..errors import refuse
from ..grid import Line, Periodic
from .contact import Contact, WakeFriction, cell_compliance, is_lagging, press
from .skin import Skin

HARMONICS = 64  # of the window, beyond which sum and integral agree: they differ as n^-3
POINTS = 32  # of the integral over a harmonic's interval of k; per decade below the first one's end
DECADES = 6  # below the first harmonic, where the integral begins


WINDOWS = (1, 2, 4, 8, 16, 32, 64)  # of the line's window, that a contact may be given
ENOUGH = 0.01  # of the lag's friction may be missing where the window is chosen here


def press_with_wake(
    line: Line, skin: Skin, height_m: Float[Array, " n"], nominal_pressure_Pa, windows: int | None
) -> Contact:
    """As [`press`][srsinv.forward.contact.press], the contact repeating with `windows` windows of
    the line: the skin is free in all but the line's own, and bears the same load.

    None: as many as the wake of a lagging skin needs, where it does not touch at the line's ends;
    else one, as always where values are traced. Raises `BadInput` for several windows where the
    skin touches at the line's ends.
    """
    own = press(line, skin, height_m, nominal_pressure_Pa)
    if isinstance(own.pressure_Pa, Tracer) or (windows in (None, 1) and not is_lagging(skin)):
        return own
    ends_touch = bool(own.touching[0] | own.touching[-1])
    refuse(
        windows not in (None, 1) and ends_touch,
        f"scene.contact_windows is {windows}, but the skin touches the window's ends: "
        "leave it null, or give a longer grid.length_m.",
    )
    if ends_touch:
        return own
    if is_lagging(skin):
        own = replace(own, wake=wake_friction(line, skin, own.pressure_Pa, WINDOWS))
    windows = windows_for(own.wake) if windows is None else windows
    return own if windows == 1 else _press_among(line, skin, height_m, nominal_pressure_Pa, windows)


def windows_for(wake: WakeFriction | None) -> int:
    """Number of windows that leave room enough for the wake; the most where none do."""
    if wake is None or not wake.is_much:
        return 1
    enough = np.flatnonzero(np.asarray(wake.missing_fraction) < ENOUGH)
    return WINDOWS[enough[0]] if enough.size else WINDOWS[-1]


def _press_among(line: Line, skin: Skin, height_m, nominal_pressure_Pa, windows: int) -> Contact:
    """The contact in the line's window, among further windows without a profile."""
    longer = Periodic(windows * line.n, line.cell_m)  # its start does not matter
    kernel = jnp.fft.irfft(cell_compliance(longer, skin), longer.n)
    # Deeper than the load displaces the skin, whatever it lies on.
    free = jnp.min(height_m) - nominal_pressure_Pa * line.n * jnp.ptp(kernel)
    height = jnp.concatenate([height_m, jnp.full(longer.n - line.n, free)])
    contact = press(longer, skin, height, nominal_pressure_Pa / windows)
    pressure, gap = contact.pressure_Pa[: line.n], contact.gap_m[: line.n]
    wake = wake_friction(longer, skin, contact.pressure_Pa) if is_lagging(skin) else None
    return replace(contact, pressure_Pa=pressure, gap_m=gap, wake=wake)


@compiled
def wake_friction(
    line: Line, skin: Skin, pressure_Pa: Float[Array, " n"], windows: tuple[int, ...] = (1,)
) -> WakeFriction:
    """Friction of the lag, for a contact with this pressure, and its missing part in longer
    windows.

    `skin` has a complex compliance; `windows` begins with 1.
    """
    power = jnp.abs(jnp.fft.rfft(pressure_Pa)) ** 2
    first, last = line.k[1], min(HARMONICS, line.n // 2 - 1)
    scale = 2 / (line.n**2 * jnp.mean(pressure_Pa))

    def work(ratio, width):
        """Sum over k = ratio x first, each standing for a stretch of width x first."""
        nearest = jnp.clip(jnp.round(ratio).astype(int), 1, last)
        k = ratio * first
        return -scale * jnp.sum(k * skin.compliance(k).imag * power[nearest] * width)

    lower = 1.5 * 10 ** (-(np.arange(DECADES * POINTS) + 0.5) / POINTS)
    even = 1.5 + (np.arange((last - 1) * POINTS) + 0.5) / POINTS
    whole = work(lower, lower * np.log(10.0) / POINTS) + work(even, 1 / POINTS)
    sums = [work(np.arange(1, int((last + 0.5) * m) + 1) / m, 1 / m) for m in windows]
    in_window = -scale * jnp.sum(line.k * cell_compliance(line, skin).imag * power)
    return WakeFriction(in_window, whole - jnp.stack(sums))
