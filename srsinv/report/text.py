"""Formatting of numbers, and of tables on the terminal."""

import math
import sys
from collections.abc import Iterable
from numbers import Integral, Real

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table as RichTable
from rich.text import Text

from .outcome import Table


def format_value(value: object) -> str:
    """A cell as text: whole numbers in full, others to four significant digits.

    Outside 1e-3 to 1e5 the exponent is a multiple of three, so that it reads as a unit's prefix:
    `0.00075` is `750e-6`.
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Integral) or not isinstance(value, Real):
        return str(value)
    number = float(value) + 0.0  # no negative zero
    if not math.isfinite(number) or number == 0 or 1e-3 <= abs(number) < 1e5:
        return _digits(number)
    # Rounded first: 999.96e-6 belongs to 1e-3.
    mantissa, _, power = f"{number:.3e}".partition("e")
    shift = int(power) % 3
    return f"{_digits(float(mantissa) * 10**shift)}e{int(power) - shift}"


def listed(names: Iterable[str]) -> str:
    """Names in a row, or "none"."""
    return ", ".join(names) or "none"


def format_with_error(value: float, stderr: float) -> str:
    """Value and standard error, to the second digit of the latter; to three decimals if it is 0."""
    decimals = max(0, 1 - math.floor(math.log10(stderr))) if stderr > 0 else 3
    return f"{value:.{decimals}f} ± {stderr:.{decimals}f}"


def is_numeric(cells: tuple[object, ...]) -> bool:
    """Whether a column holds numbers only, and so is aligned on the right."""
    return bool(cells) and all(
        isinstance(cell, Real) and not isinstance(cell, bool) for cell in cells
    )


def print_table(table: Table) -> None:
    """Print `table` on standard output: without styles and as wide as needed where that is no
    terminal."""
    console = Console(file=sys.stdout, highlight=False)
    drawn = RichTable(box=box.SIMPLE_HEAD if console.is_terminal else box.MARKDOWN)
    columns = tuple(zip(*table.rows, strict=True)) or ((),) * len(table.columns)
    for heading, cells in zip(table.columns, columns, strict=True):
        justify = "right" if is_numeric(cells) else "left"
        drawn.add_column(Text(heading), justify=justify, overflow="fold")
    for row in table.rows:
        drawn.add_row(*(Text(format_value(cell)) for cell in row))
    if console.is_terminal:
        console.print(Text(table.caption), drawn, *map(Text, table.notes))
        return
    roomy = console.options.update(max_width=10_000)
    console.width = Measurement.get(console, roomy, drawn).maximum
    with console.capture() as lines:
        console.print(drawn)
    # Markdown's box has blank lines around the table.
    unformatted = (line.rstrip() for line in lines.get().splitlines())
    print(*filter(None, (table.caption, *unformatted, *table.notes)), sep="\n")


def _digits(number: float) -> str:
    return f"{number:.0f}" if abs(number) >= 1000 else f"{number:.4g}"
