"""Effects beside the ideal sensor: thin edits of a scenario, one module each.

An effect that is not named is not imported, and leaves nothing in the compiled program. The names
of the package's own effects are those of the modules but `general`, whose effects take any part of
a kind and have the name that a configuration gives them.
"""

from pathlib import Path

from ._effect import Effect, Order, add_effects
from ._reference import ReferenceSpectra, reference
from ._screen import ScreeningResult, screen
from ._screen_simulation import forget_screenings, screen_effects

__all__ = [
    "NAMES",
    "Effect",
    "Order",
    "ReferenceSpectra",
    "ScreeningResult",
    "add_effects",
    "forget_screenings",
    "reference",
    "screen",
    "screen_effects",
]

NAMES = tuple(
    sorted(
        path.stem
        for path in Path(__file__).parent.glob("*.py")
        if not path.stem.startswith("_") and path.stem != "general"
    )
)
