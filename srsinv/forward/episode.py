"""A contact episode in time: touch, rest, pull until it slips, slide over an edge, leave.

A rounded finger rests on a plate while its load and its shear force change, so that the charge of
each film is the sum of its responses to the traction, and a rate signal the change of that charge
in time. For example, a light touch of 20 N/m that is pulled to full slip within 0.1 s:

    episode = Episode(CylinderContact(0.01, 0.6e-3), 20.0, touch=Ramp(0.1, 0.05),
                      pull=Ramp(0.3, 0.1), friction=0.6, sliding_friction=0.5)
    volts = RecordedEpisode(episode, srsinv.Sensor()).signal(5000.0, 3000)

The load arrives as P [1 - (1 - s)^n] and leaves as P [1 - s^n], s from 0 to 1 over the ramp: it
grows from the first instant of contact at a finite rate, and falls to zero at one, as that of a
finger that is moved at a finite speed. The shear force grows as mu P s^n from rest, in partial slip
(partial_slip.py), until all slips. The friction then falls from its static to its sliding value.
An edge that passes under the contact redistributes the pressure under the constant load, found by
the contact solver at many places.
"""

from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray
from scipy.interpolate import PchipInterpolator
from scipy.signal import lfilter

from ..compiled import compiled
from ..errors import number, refuse, whole
from ..grid import Periodic, as_real
from .contact import press
from .filter import filtered
from .knife_edge import line_response
from .partial_slip import CylinderContact, check_similar
from .sensor import Sensor
from .shape import Shape
from .vibration import gain_at_rest

KINDS_OF_EVENT = ("first contact", "incipient slip", "full slip", "edge", "loss of contact")
HALF_CELLS = 60  # over half the contact: charge is then exact to about 1e-3 of an edge's
CELLS = 4096  # of the window: 34 half-widths to either side
PLACES = 256  # of an edge along its way
BEGUN = 1e-3  # of an edge's greatest change of charge: it has begun
FARTHEST = 25.0  # half-widths: an edge that touches farther out meets the window's end


class Ramp(eqx.Module):
    """A change of a force from `start_s` [s] on, over `duration_s` [s], as the power `exponent`.

    Raises `BadInput` for a duration that is not positive and an exponent below 1.
    """

    start_s: float = eqx.field(static=True)
    duration_s: float = eqx.field(static=True)
    exponent: float = eqx.field(static=True)

    def __init__(self, start_s: Any, duration_s: Any, exponent: Any = 2.0):
        self.start_s = float(number("ramp start_s", start_s, "a time in seconds"))
        wanted = "a positive time in seconds"
        self.duration_s = float(number("ramp duration_s", duration_s, wanted, above=0))
        wanted = "a power, 1 or more"
        self.exponent = float(number("ramp exponent", exponent, wanted, least=1))

    @property
    def end_s(self) -> float:
        """When the change is complete [s]."""
        return self.start_s + self.duration_s

    def growing(self, time_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """s^n: from 0 to 1, slowly at first."""
        return np.clip((time_s - self.start_s) / self.duration_s, 0, 1) ** self.exponent

    def arriving(self, time_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """1 - (1 - s)^n: from 0 to 1, slowly at last."""
        return 1 - np.clip((self.end_s - time_s) / self.duration_s, 0, 1) ** self.exponent


class PassingEdge(eqx.Module):
    """A shape on the plate, about x = 0, whose middle is under that of the contact at `at_s` [s],
    as the finger slides at `speed_m_per_s` [m/s] towards +x.

    Raises `BadInput` for a speed that is not positive.
    """

    shape: Shape
    at_s: float = eqx.field(static=True)
    speed_m_per_s: float = eqx.field(static=True)

    def __init__(self, shape: Shape, at_s: Any, speed_m_per_s: Any = 0.05):
        self.shape = shape
        self.at_s = float(number("edge at_s", at_s, "a time in seconds"))
        wanted = "a positive speed in m/s"
        self.speed_m_per_s = float(number("edge speed_m_per_s", speed_m_per_s, wanted, above=0))

    def charge(
        self,
        sensor: Sensor,
        contact: CylinderContact,
        load_N_per_m: float,
        friction: float,
        half_cells: int = HALF_CELLS,
    ) -> PchipInterpolator:
        """What the edge adds to the charge [C] (element, time), as a function of time [s] between
        its first touch and its last, solved on `half_cells` over half the contact.

        Raises `BadInput` for a flat edge, and for one so high that it touches farther than 25
        half-widths out.
        """
        check_similar(sensor.skin)
        half = float(contact.half_width_m(sensor.skin, load_N_per_m))
        cell = half / half_cells
        line = Periodic(CELLS, cell, -CELLS // 2 * cell)
        height, x = np.asarray(self.shape.height(line)), np.asarray(line.x)
        refuse(not np.ptp(height) > 0, "The edge is flat: give it a height other than 0.")
        reach = half + 2 * np.sqrt(2 * contact.radius_m * np.ptp(height))
        refuse(
            reach > FARTHEST * half,
            f"The edge is {np.ptp(height):.3g} m high, too much for a contact {2 * half:.3g} m "
            "wide: give a lower edge, a greater load or a smaller radius_m.",
        )
        every = int(np.ceil(2 * reach / cell / PLACES))
        # The edge moves backwards under a finger that slides towards +x.
        shifts = every * (PLACES // 2 - np.arange(PLACES + 1))
        heights = -(x**2) / (2 * contact.radius_m) + np.stack([np.roll(height, s) for s in shifts])
        pressure = _pressures(
            line, sensor.skin, as_real(heights), as_real(load_N_per_m / (CELLS * cell))
        )
        kernel = cell * line_response(sensor, -contact.place_m - x)
        charge = np.asarray(pressure) @ (kernel[:, 0] + friction * kernel[:, 1]).T
        time = self.at_s - shifts * cell / self.speed_m_per_s
        return PchipInterpolator(time, (charge - charge[0]).T, axis=1)


@compiled
def _pressures(line: Periodic, skin, heights, nominal) -> Float[Array, "place n"]:
    return jax.lax.map(lambda h: press(line, skin, h, nominal).pressure_Pa, heights)


class ForceHistory(NamedTuple):
    """Over time (time,): load and shear force [N/m], friction, and whether all slips."""

    load_N_per_m: Float[np.ndarray, " time"]
    shear_N_per_m: Float[np.ndarray, " time"]
    friction: Float[np.ndarray, " time"]
    slips: Bool[np.ndarray, " time"]


class Episode(eqx.Module):
    """The events of one contact; those that are None do not happen.

    - `contact`: the finger; `load_N_per_m` [N/m]: its load at rest, above 0.
    - `touch`, `pull`, `release`: when the load arrives, the shear force grows to full slip, and the
      load leaves. `edge`: passes during full slip.
    - `friction`, `sliding_friction`: static, and in full slip; the latter is reached
      as exp(-t/`drop_s`).

    Numbers are concrete, not traced. Raises `BadInput` for frictions that are not positive or grow
    by sliding, and for events out of order.
    """

    contact: CylinderContact
    load_N_per_m: float = eqx.field(static=True)
    touch: Ramp
    pull: Ramp | None
    edge: PassingEdge | None
    release: Ramp | None
    friction: float = eqx.field(static=True)
    sliding_friction: float = eqx.field(static=True)
    drop_s: float = eqx.field(static=True)

    def __init__(
        self,
        contact: CylinderContact,
        load_N_per_m: Any,
        touch: Ramp,
        pull: Ramp | None = None,
        edge: PassingEdge | None = None,
        release: Ramp | None = None,
        friction: Any = 0.6,
        sliding_friction: Any = 0.5,
        drop_s: Any = 5e-3,
    ):
        self.contact, self.touch, self.pull = contact, touch, pull
        self.edge, self.release = edge, release
        wanted = "a positive load in N/m"
        self.load_N_per_m = float(number("episode load_N_per_m", load_N_per_m, wanted, above=0))
        wanted = "a friction coefficient above 0"
        self.friction = float(number("episode friction", friction, wanted, above=0))
        wanted = f"a friction coefficient above 0, at most {self.friction:g}"
        self.sliding_friction = float(
            number("episode sliding_friction", sliding_friction, wanted, above=0, most=friction)
        )
        wanted = "a positive time in seconds"
        self.drop_s = float(number("episode drop_s", drop_s, wanted, above=0))
        refuse(edge is not None and pull is None, "An edge passes in full slip: give a pull too.")
        ends = [touch.end_s]
        ends += [] if pull is None else [pull.start_s, pull.end_s]
        ends += [] if edge is None else [edge.at_s]
        ends += [] if release is None else [release.start_s]
        refuse(
            ends != sorted(ends),
            f"The episode's events begin and end at {[round(each, 6) for each in ends]} s: give "
            "increasing times, in the order touch, pull, edge, release.",
        )

    def forces(self, time_s: Float[np.ndarray, " time"]) -> ForceHistory:
        """Forces and friction over time."""
        load = self.load_N_per_m * self.touch.arriving(time_s)
        if self.release is not None:
            load = load - self.load_N_per_m * self.release.growing(time_s)
        load = np.maximum(load, 0)
        friction, slips = np.full(time_s.shape, self.friction), np.zeros(time_s.shape, bool)
        if self.pull is None:
            return ForceHistory(load, np.zeros(time_s.shape), friction, slips)
        slips = time_s >= self.pull.end_s
        since = np.maximum(time_s - self.pull.end_s, 0)
        drop = self.friction - self.sliding_friction
        friction = self.sliding_friction + drop * np.exp(-since / self.drop_s)
        pulled = np.where(slips, 1.0, self.pull.growing(time_s))
        return ForceHistory(load, friction * load * pulled, friction, slips & (load > 0))


class RecordedEpisode:
    """An episode as a resting sensor records it. The contacts with its edge are solved once.

    Raises `BadInput`, once it is asked for charge, signal or onsets, for a skin on which partial
    slip is not solved, and for an edge that touches before full slip or while the load leaves.
    """

    def __init__(self, episode: Episode, sensor: Sensor):
        self.episode, self.sensor = episode, sensor

    @cached_property
    def edge_charge(self) -> PchipInterpolator | None:
        """What the edge adds to the charge [C] (element, time), as a function of time [s]."""
        own = self.episode
        if own.edge is None or own.pull is None:
            return None
        added = own.edge.charge(self.sensor, own.contact, own.load_N_per_m, own.sliding_friction)
        first, last = touching_s(added)
        until = np.inf if own.release is None else own.release.start_s
        refuse(
            first < own.pull.end_s or last > until,
            f"The edge touches from {first:.6g} to {last:.6g} s, which is not all in full slip and "
            f"under the whole load: give edge at_s between {own.pull.end_s:.6g} and {until:.6g} s, "
            "farther from both.",
        )
        return added

    def charge(self, time_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, "element time"]:
        """Charge [C] of every element at these times."""
        forces, load = self.episode.forces(time_s), self.episode.load_N_per_m
        charge = self.episode.contact.charge(self.sensor, load)(*forces[:3])
        if self.edge_charge is not None:
            charge = charge + self.edge_charge(np.clip(time_s, *self.edge_charge.x[[0, -1]]))
        return charge

    def signal(self, rate_hz: Any, samples: Any) -> Float[np.ndarray, "element sample"]:
        """The signal at the times j/`rate_hz`, without noise, as `sampled` has it.

        Raises `BadInput` for a rate that is not positive, and for fewer samples than one.
        """
        rate = float(number("rate_hz", rate_hz, "a positive rate in Hz", above=0))
        count = whole("samples", samples, "a whole number from 1", least=1)
        time = np.arange(-1, count) / rate
        return sampled(self.sensor, self.charge(time), rate)

    @property
    def onsets_s(self) -> dict[str, float]:
        """When each event begins [s], by its kind: an edge as it first changes the
        charge by a thousandth of its greatest change."""
        own = self.episode
        onsets = {KINDS_OF_EVENT[0]: own.touch.start_s}
        if own.pull is not None:
            onsets |= {KINDS_OF_EVENT[1]: own.pull.start_s, KINDS_OF_EVENT[2]: own.pull.end_s}
        if self.edge_charge is not None:
            onsets[KINDS_OF_EVENT[3]] = touching_s(self.edge_charge)[0]
        if own.release is not None:
            onsets[KINDS_OF_EVENT[4]] = own.release.start_s
        return onsets


def touching_s(edge_charge: PchipInterpolator) -> tuple[float, float]:
    """When an edge begins and ends to change the charge by a thousandth of its greatest change."""
    size = np.abs(edge_charge(edge_charge.x)).max(0)
    first, last = edge_charge.x[size > BEGUN * size.max()][[0, -1]]
    return float(first), float(last)


def sampled(
    sensor: Sensor, charge_C: Float[np.ndarray, "element time"], rate_hz: float
) -> Float[np.ndarray, "element sample"]:
    """The recorded signal of a resting sensor from its charge [C] at even times, the first of which
    is one interval before the first sample.

    A sample of a rate signal is the mean over the interval before it, R_f (Q_j - Q_{j-1})/dt, so
    that the jump of the rate at first contact needs no care. Filters act on the samples. Raises
    `BadInput` for an amplifier that integrates along x.
    """
    gain, order = gain_at_rest(sensor.amplifier), sensor.amplifier.order
    signal = gain * (np.diff(charge_C) * rate_hz if order else charge_C[:, 1:])
    return np.asarray(filtered(sensor.filters, as_real(signal), as_real(1 / rate_hz)), float)


def slip_noise(
    key: PRNGKeyArray,
    slips: Bool[np.ndarray, " sample"],
    rms_V: float,
    correlation_samples: float,
    elements: int,
) -> Float[np.ndarray, "element sample"]:
    """Noise of sliding, in full slip alone: correlated as exp(-lag/`correlation_samples`), of this
    rms after some such lags, independent from element to element."""
    keep = np.exp(-1 / correlation_samples)
    fresh = np.asarray(jax.random.normal(key, (elements, slips.size)), float)
    drive = np.where(slips, rms_V * np.sqrt(1 - keep**2) * fresh, 0.0)
    return np.where(slips, lfilter([1.0], [1.0, -keep], drive), 0.0)
