"""Effects beside the ideal sensor: thin edits of a scenario, one module each.

An effect that is not named is not imported, and leaves nothing in the compiled program. The names
of the package's own effects are those of the modules.
"""

from pathlib import Path

from ._effect import Effect, Order
from ._reference import ReferenceSpectra, reference
from ._screen import ScreeningResult, screen

__all__ = ["NAMES", "Effect", "Order", "ReferenceSpectra", "ScreeningResult", "reference", "screen"]

NAMES = tuple(
    sorted(p.stem for p in Path(__file__).parent.glob("*.py") if not p.stem.startswith("_"))
)
