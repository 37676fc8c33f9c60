"""Refusals of parts of a sensor that are of their kind, and yet cannot be: a stranger's."""

import numbers

import numpy as np
from jaxtyping import Array, Complex, Float

from ..errors import all_of_kind, echo, of_kind, refuse, whole
from .amplifier import Amplifier
from .filter import Filter
from .skin import STRESSES, Skin

SAME = 1e-9  # by which poles differ, and moduli, that only rounding tells apart


def check_amplifier(amplifier: Amplifier) -> None:
    """Refuse an order or a unit that is none."""
    name = type(amplifier).__name__
    whole(f"{name}.order", amplifier.order, "0 for the charge, 1 for the current", least=0, most=1)
    of_kind(f"{name}.unit", amplifier.unit, str, "a word, as 'V'")


def check_poles(filter: Filter) -> None:
    """Refuse poles that do not make a filter that is stable and real."""
    name, kind = f"{type(filter).__name__}.poles", "poles, as (-0.6 + 0.8j, -0.6 - 0.8j)"
    poles = np.array(all_of_kind(name, filter.poles, numbers.Complex, kind), complex)
    separations = np.abs(poles[:, None] - poles) + np.eye(poles.size)
    unpaired = np.abs(poles[:, None] - poles.conj()).min(axis=0, initial=np.inf) > SAME
    fits = np.all(np.real(poles) < 0) and np.all(np.abs(np.abs(poles) - 1) < SAME)
    refuse(
        not (poles.size and fits) or bool(np.any(separations < SAME) or np.any(unpaired)),
        f"{name} is {echo(filter.poles)}: give distinct poles of modulus 1 with "
        "negative real parts, complex ones in conjugate pairs.",
    )


def stress_in(
    skin: Skin, k: Float[Array, " k"], depth_m: Float[Array, ""]
) -> Complex[Array, "4 2 k"]:
    """The stress in a skin under unit traction; refused where it has another shape."""
    stress, wanted = skin.transfer(k, depth_m), (len(STRESSES), 2, *k.shape)
    refuse(
        getattr(stress, "shape", None) != wanted,
        f"{type(skin).__name__}.transfer gives {echo(stress)}: give the stresses "
        f"{', '.join(STRESSES)} under p and q at every k, of the shape {wanted}.",
    )
    return stress
