"""Settings of a fit of surface features: what is refused of them."""

from typing import Any

from ...errors import number, refuse
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
    for name in also:
        refuse(
            name not in KNOWN and not _is_parameter(features, name),
            f"fit.free names {name!r}: beside the features' own parameters it can name "
            f"{', '.join(KNOWN)}.",
        )
    return tuple(name for name in also if name in KNOWN)


def _is_parameter(features: Features, name: str) -> bool:
    return name == "base_friction" or any(
        name in (*feature.axes, *feature.linear) for feature in features.values()
    )
