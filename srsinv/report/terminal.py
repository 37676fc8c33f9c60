"""The printed view of a result."""

import sys

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table as RichTable
from rich.text import Text

from .result import Result
from .text import format_value, is_numeric
from .words import Paragraph, Table, answers, no_answer, summary


def print_summary(result: Result) -> None:
    """Print what a result states: its title, the summary, and of each answer that is not good the
    reasons."""
    print(result.title)
    for block in summary(result.sections, result.dataset):
        if isinstance(block, Table):
            print_table(block)
        elif isinstance(block, Paragraph):
            print(block.text)
    for name, (quality, reasons) in answers(result.dataset).items():
        if reasons:
            print(f"{name or 'The answer'}, {quality}: {no_answer(quality)}{reasons}")


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
        console.print(drawn, Text(table.caption))
        return
    roomy = console.options.update(max_width=10_000)
    console.width = Measurement.get(console, roomy, drawn).maximum
    with console.capture() as lines:
        console.print(drawn)
    # Markdown's box has blank lines around the table.
    unformatted = (line.rstrip() for line in lines.get().splitlines())
    print(*filter(None, (*unformatted, table.caption)), sep="\n")
