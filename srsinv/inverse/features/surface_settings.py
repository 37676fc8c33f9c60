"""Settings of a fit of surface features: what is refused of them."""

from typing import Any

from ...errors import check_name, number, refuse
from .contact import KNOWN
from .loading import Features


def checked_pressure(given: Any) -> float:
    """The nominal pressure, refused where none is known."""
    refuse(
        given is None,
        "No nominal pressure is known, which a surface is pressed on with: give "
        "recording.nominal_pressure_Pa, the mean over the contact window.",
    )
    wanted = "a positive pressure in Pa"
    return float(number("recording.nominal_pressure_Pa", given, wanted, above=0))


def checked_names(features: Features, also: tuple[str, ...]) -> tuple[str, ...]:
    """Those of `KNOWN` among the names, refused where one is of no parameter."""
    own = [part for each in features.values() for part in (*each.axes, *each.linear)]
    for name in also:
        check_name("fit.free", name, dict.fromkeys((*KNOWN, "base_friction", *own)))
    return tuple(name for name in also if name in KNOWN)
