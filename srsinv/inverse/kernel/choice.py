"""The likeliest prior of kernels: its numbers by the evidence's slopes, its envelope and the far
field's error step by step among a few."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .evidence import Envelope, Prior, Products, likeliest
from .signals import About

WIDTHS = 0.5, 1.0, 2.0, 4.0  # depths: the envelope's width,
FAR_PARTS = 0.03, 1.0  # what is left of it far from the load,
FARS = 0.1, 1.0  # and of the stated kernel, by which the far field may be off
CHOICES = {"width": WIDTHS, "far_part": FAR_PARTS, "far": FARS}


class Place(NamedTuple):
    """One of each of the choices."""

    width: float = WIDTHS[0]
    far_part: float = FAR_PARTS[0]
    far: float = FARS[0]

    def envelope(self, depth_m: float) -> Envelope:
        """The envelope at a film's depth."""
        return Envelope(self.width * depth_m, self.far_part)

    @property
    def neighbours(self) -> list["Place"]:
        """Those one step away."""
        found = []
        for name, choices in CHOICES.items():
            at = choices.index(getattr(self, name))
            for other in (*choices[at + 1 : at + 2], *choices[max(at - 1, 0) : at]):
                found.append(self._replace(**{name: other}))
        return found


class Chosen(NamedTuple):
    """The likeliest prior with its place and evidence, and the products under it, of parameters
    in these `units` (c,)."""

    place: Place
    prior: Prior
    evidence: float
    products: list[Products]
    units: Float[np.ndarray, " c"]


def choose(
    about: Sequence[About],
    first: Prior,
    place: Place,
    t0: Float[np.ndarray, " c"],
    shared: bool,
    is_free: bool = True,
) -> Chosen:
    """The likeliest prior of these elements, from a first one: from place to place as long as a
    neighbour is likelier, or at the first alone where that `is_free` not.

    t is normal about -`t0`, the far fields of all elements its last; `shared`: see `likeliest`.
    """
    signals = about[0].signals
    far_fields = t0.size - 2 * len(signals.elements)

    def at(place: Place, start: Prior) -> Chosen:
        units = np.where(np.arange(t0.size) < far_fields, 1.0, place.far)
        envelope = place.envelope(signals.lags.depth_m)
        own = [each.under(envelope).scaled(units) for each in about]
        start = start._replace(envelope=envelope)
        prior, evidence = likeliest(own, start, signals.k, t0, shared)
        return Chosen(place, prior, evidence, own, units)

    best, tried = at(place, first), {place}
    left = place.neighbours if is_free else []
    while left:
        tried.add(left[0])
        found = at(left[0], best.prior)
        if found.evidence > best.evidence:
            best, left = found, [each for each in found.place.neighbours if each not in tried]
        else:
            left = left[1:]
    return best
