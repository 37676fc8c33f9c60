"""Where the contact sticks: by the closed form and by the contact solver, and over time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from srsinv.forward.episode import Episode
from srsinv.forward.partial_slip import CylinderContact, press_and_shear
from srsinv.forward.skin import Skin
from srsinv.grid import Periodic

CELLS, WINDOW = 4000, 40.0  # half-widths: the neighbours change the contact by 5e-4
PROFILE = 401


def half_widths(
    skin: Skin, given: Mapping[str, Any]
) -> tuple[Float[np.ndarray, " ratio"], Float[np.ndarray, " ratio"]]:
    """Half-width of the part that sticks, over that of the contact's closed form, at each ratio of
    the shear force to its value at full slip: by the closed form, and solved."""
    contact, load, mu = CylinderContact(given["radius_m"]), given["load_N_per_m"], given["friction"]
    half = float(contact.half_width_m(skin, load))
    window = WINDOW * half
    line = Periodic(CELLS, window / CELLS, -window / 2)
    height = -(np.asarray(line.x) ** 2) / (2 * contact.radius_m)
    closed, solved = [], []
    for ratio in given["shear_ratios"]:
        shear = ratio * mu * load
        slip = press_and_shear(line, skin, height, load / window, shear / window, mu)
        _, ((left, right), *_) = slip.zone_edges_m(line)
        solved.append((right - left) / 2 / half)
        closed.append(float(contact.stick_half_width_m(skin, load, shear, mu)) / half)
    return np.array(closed), np.array(solved)


def tractions(
    skin: Skin, episode: Episode, ratios: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pressure (x,), shear (ratio, x) [Pa] and positions [m], as the shear force grows."""
    load, mu = episode.load_N_per_m, episode.friction
    half = float(episode.contact.half_width_m(skin, load))
    x = 1.2 * half * np.linspace(-1, 1, PROFILE)
    each = [episode.contact.traction(skin, x, load, ratio * mu * load, mu) for ratio in ratios]
    return each[0][0], np.stack([one[1] for one in each]), x


def zones(
    skin: Skin, episode: Episode, time_s: Float[np.ndarray, " time"]
) -> tuple[np.ndarray, np.ndarray]:
    """Half-widths [m] of the contact and of the part that sticks, over time."""
    forces = episode.forces(time_s)
    stuck = episode.contact.stick_half_width_m(skin, *forces[:3])
    # In full slip the difference of forces rounds to little more than zero.
    return episode.contact.half_width_m(skin, forces[0]), np.where(forces.slips, 0.0, stuck)
