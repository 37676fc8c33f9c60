"""A window with p, q and the noise level that follows a live inversion."""

import os
import subprocess
import sys
from contextlib import suppress

from ..errors import BadInput, refuse
from ..inverse.live.live import LiveCells
from ._live_lines import lines_of


def check_display() -> None:
    """Refuse a window where there is no display to show it on."""
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    refuse(
        sys.platform == "linux" and not has_display,
        "live.view=true needs a display, and neither DISPLAY nor WAYLAND_DISPLAY is set: leave "
        "live.view out, or log in with ssh -X.",
    )


class LiveView:
    """The window. Where somebody closes it, the inversion goes on; it stays open at the end.

    - `unit`: of the signal, in which the noise is.

    Raises `BadInput` where no window can be opened.
    """

    def __init__(self, unit: str):
        check_display()
        environment = {key: v for key, v in os.environ.items() if key != "MPLBACKEND"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "srsinv.jobs._live_window", unit],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            env=environment, start_new_session=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        if not self._process.stdout.readline():
            raise BadInput(
                "live.view=true needs a toolkit with windows, and none can be used here: install "
                "one, as pip install PyQt6, or leave live.view out."
            )

    def show(self, cells: LiveCells) -> None:
        """Add finished cells."""
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):  # it was closed
            self._process.stdin.writelines(f"{line}\n" for line in lines_of(cells))
            self._process.stdin.flush()
