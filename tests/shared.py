"""The data folder that stands beside the project, and the mark for tests that read it."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"
needs_shared = pytest.mark.skipif(
    not SHARED.is_dir(), reason="needs the shared folder beside the project"
)
