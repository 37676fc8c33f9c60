"""The finger touches over a finite zone, which travels with it."""

from typing import Any

from ..errors import choice, refuse
from ..forward.envelope import FoundationPatch, HertzPatch
from .general import EnvelopeEffect

ZONES = {"hertz": HertzPatch, "foundation": FoundationPatch}
STIFFNESS = {"hertz": "contact_modulus_Pa", "foundation": "foundation_Pa_per_m"}


class FinitePatch(EnvelopeEffect):
    """The contact zone |xi| < a of a cylindrical finger, in which it presses less towards the edge.

    - `profile`: "hertz", sqrt(1 - (xi/a)^2), a solid finger; "foundation", 1 - (xi/a)^2, a soft
      foam below a thin skin.
    - `half_width_m` [m]: a. None: from `radius_m` [m] of the finger and `load_N_per_m` [N/m], with
      `contact_modulus_Pa` [Pa] of a solid or `foundation_Pa_per_m` [Pa/m] of a foam.

    Raises `BadInput` for another profile, for values that are not positive, and unless either the
    half-width or all that it follows from is given.
    """

    def __init__(
        self,
        profile: Any = "foundation",
        half_width_m: Any = None,
        radius_m: Any = None,
        load_N_per_m: Any = None,
        contact_modulus_Pa: Any = None,
        foundation_Pa_per_m: Any = None,
    ):
        key = "effects.finite_patch"
        zone = ZONES[choice(f"{key}.profile", profile, ZONES)]
        stiffness = {
            "contact_modulus_Pa": contact_modulus_Pa,
            "foundation_Pa_per_m": foundation_Pa_per_m,
        }[STIFFNESS[profile]]
        given = radius_m, load_N_per_m, stiffness
        if half_width_m is not None:
            self.envelope = zone(half_width_m)
            return
        refuse(
            any(each is None for each in given),
            f"{key}.half_width_m is null: give it in metres, or radius_m, load_N_per_m and "
            f"{STIFFNESS[profile]}.",
        )
        self.envelope = zone.under_load(*given)
