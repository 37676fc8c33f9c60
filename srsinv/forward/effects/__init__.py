"""Effects beside the ideal sensor: one module each, added to a scenario where a scene names them.

Nothing here is imported before a configuration names it, and the names are those of the modules.
"""

from pathlib import Path

NAMES = tuple(
    sorted(p.stem for p in Path(__file__).parent.glob("*.py") if not p.stem.startswith("_"))
)
