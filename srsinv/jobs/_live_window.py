"""The window of a live inversion: a process that draws the lines of cells on its standard input.

`python -m srsinv.jobs._live_window UNIT` opens it, prints a line once it stands, and stays until
somebody closes it. It is a process of its own, as windows need a main thread.
"""

import sys
import threading
from collections import deque
from contextlib import suppress
from typing import Any

import numpy as np

from ..numerics import BAND_90

TOOLKITS = ("QtAgg", "TkAgg", "GTK4Agg", "GTK3Agg", "WXAgg", "MacOSX")
SHOWN_CELLS = 1000  # the newest ones
EVERY_S = 0.1  # between two drawings
OPEN = "open"  # printed once the window stands


def main(unit: str) -> int:
    """Draw until the window is closed; the exit code, 1 where none can be opened."""
    opened = _opened()
    if opened is None:
        return 1
    plt, figure = opened
    axes: dict[str, Any] = dict(
        zip(("p", "q", "noise"), figure.subplots(3, 1, sharex=True), strict=True)
    )
    labels = {"p": "p [kPa]", "q": "q [kPa]", "noise": f"noise [{unit}]"}
    for name, label in labels.items():
        axes[name].set_ylabel(label)
    axes["noise"].set_xlabel("position x [mm]")
    rows: deque[tuple[float, ...]] = deque(maxlen=SHOWN_CELLS)
    news = threading.Event()
    threading.Thread(target=_read, args=(rows, news), daemon=True).start()
    print(OPEN, flush=True)
    while plt.fignum_exists(figure.number):
        if news.is_set():
            news.clear()
            _draw(axes, np.array(list(rows)).T)
            figure.canvas.draw_idle()
        figure.canvas.start_event_loop(EVERY_S)
    return 0


def _opened() -> Any:
    """pyplot with the first toolkit that has windows, and an open figure; None without one."""
    import matplotlib.pyplot as plt

    for toolkit in TOOLKITS:
        with suppress(Exception):  # each fails in its own way where it is not installed
            plt.switch_backend(toolkit)
            figure = plt.figure("srsinv: live inversion", figsize=(9, 7), layout="constrained")
            figure.show()
            return plt, figure
    return None


def _read(rows: deque[tuple[float, ...]], news: threading.Event) -> None:
    """Take the lines in; a step back in x begins a new picture, as of a new pass."""
    for line in sys.stdin:
        row = tuple(float(cell) for cell in line.split(","))
        if len(rows) > 1 and (row[0] - rows[-1][0]) * (rows[-1][0] - rows[-2][0]) < 0:
            rows.clear()
        rows.append(row)
        news.set()


def _draw(axes: Any, columns: np.ndarray) -> None:
    x, p, p_stderr, q, q_stderr, noise = columns
    for artist in [each for one in axes.values() for each in (*one.lines, *one.collections)]:
        artist.remove()
    for name, value, stderr in (("p", p, p_stderr), ("q", q, q_stderr)):
        half = BAND_90 * stderr
        low, high = 1e-3 * (value - half), 1e-3 * (value + half)
        axes[name].fill_between(1e3 * x, low, high, color="C0", alpha=0.22, linewidth=0)
        axes[name].plot(1e3 * x, 1e-3 * value, color="C0")
    axes["noise"].plot(1e3 * x, noise, color="C1")
    for one in axes.values():
        one.relim()
        one.autoscale_view()
    axes["noise"].set_ylim(0.0, 1.1 * float(noise.max()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
