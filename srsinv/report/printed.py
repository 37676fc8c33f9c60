"""The report of one answer, an estimate or a fit, as text and as HTML for a notebook."""

import textwrap
from collections.abc import Iterator, Sequence

import markupsafe
import numpy as np
import xarray

from ..errors import printable
from ..numerics import BAND_90, mean_known
from . import text as words_of
from .words import Paragraph, Table, no_answer

WIDTH = 100  # characters of a line of text
MOST_LINES = 38  # of text
MOST_ROWS = 15  # parameters in a table of text; a notebook shows all
_WIDEST_CELL = 44
_CELL = "text-align:left;padding:0.1em 1em 0.1em 0;border:0"


def text(data: xarray.Dataset, reasons: Sequence[str]) -> str:
    """The report of the answer whose dataset this is, in lines of at most `WIDTH` characters and at
    most `MOST_LINES` of them; `reasons` say why it is not good."""
    lines: list[str] = []
    for block in _blocks(data, MOST_ROWS):
        lines += _table_lines(block) if isinstance(block, Table) else _wrapped(block.text)
    lines.append("")
    left = MOST_LINES - len(lines)
    for at, reason in enumerate(reasons):
        own = _wrapped(reason, "- ")
        if len(own) > left - 1:
            lines.append(f"- {len(reasons) - at} more: see its warnings")
            break
        lines, left = lines + own, left - len(own)
    return "\n".join(lines).rstrip()


def html(data: xarray.Dataset, reasons: Sequence[str]) -> str:
    """The same as HTML without colours of its own, every text escaped."""
    first, *blocks = _blocks(data)
    assert isinstance(first, Paragraph)
    parts = [f"<p><b>{_escaped(first.text)}</b></p>"]
    for block in blocks:
        parts.append(_html_table(block) if isinstance(block, Table) else _html_line(block.text))
    items = "".join(f"<li>{_escaped(each)}</li>" for each in reasons)
    return f"<div>{''.join(parts)}{f'<ul>{items}</ul>' if items else ''}</div>"


def _blocks(data: xarray.Dataset, most_rows: int | None = None) -> Iterator[Paragraph | Table]:
    """What the answer is and how good, then its parameters, then p and q, or the unknown of a
    linear problem."""
    quality = str(data["quality"].item())
    words = f"{data.attrs['title']}; quality: {quality}. {no_answer(quality).capitalize()}"
    yield Paragraph(words.strip())
    yield Paragraph(_numbers(data))
    if "reported" in data.dims:
        yield from _parameters(data, most_rows)
    if "value_stderr" in data:
        yield _unknown(data)
    if "estimate" in data:
        yield _traction(data)
        unobserved = data.attrs.get("mean_unobserved", "").replace(",", " and ")
        if unobserved:
            yield Paragraph(
                f"The signal does not show the mean of {unobserved}: values and standard errors "
                "are those up to a constant."
            )


def _numbers(data: xarray.Dataset) -> str:
    """How many samples, what is left of them, and how the computation ended."""
    if "posterior_draws" in data:
        chains, draws = data.sizes["chain"], data.sizes["draw"]
        diverged = int(data["divergences"])
        return (
            f"{chains} chains of {draws} draws after {int(data['warmup'])} to adapt; "
            f"{diverged} diverged; {data['status'].item()}."
        )
    used = int(np.isfinite(data["whitened_residual"].values).sum())
    elements = data.sizes["element"]
    said = [f"{used} data points"]
    if "estimate" in data:
        own = f"{used} data points of {elements} element{'s' * (elements > 1)}"
        said = [f"{own}, {data.sizes['x']} cells"]
    if "value_stderr" in data:
        said = [f"{used} data points, {data['value'].size} unknowns"]
    chi2, freedom = float(data["chi2_per_freedom"]), float(data["degrees_of_freedom"])
    if np.isfinite(chi2):
        left = words_of.significant(chi2)
        said.append(f"chi-square {left} per degree of freedom, of {freedom:.0f}")
    if "noise_rms" in data:
        level = words_of.significant(float(data["noise_rms"]))
        said.append(f"noise {level} rms, estimated from the residual")
    return f"{'; '.join(said)}; {data['status'].item()}."


def _parameters(data: xarray.Dataset, most: int | None) -> Iterator[Paragraph | Table]:
    """Name, value, interval and note of each parameter; those of one quantity share a unit."""
    names, units = data["reported"].values.tolist(), data["parameter_unit"].values.tolist()
    values, stderrs = (data[f"parameter_{end}"].values.tolist() for end in ("value", "stderr"))
    notes = data["parameter_note"].values.tolist()
    ends = [(np.nan, np.nan)] * len(names)
    if "parameter_low" in data:
        pairs = data["parameter_low"].values, data["parameter_high"].values
        ends = list(zip(*pairs, strict=True))
    sizes = [max(abs(v), s) if np.isfinite(s) else v for v, s in zip(values, stderrs, strict=True)]
    scales = words_of.units_for_rows(sizes, units)
    rows = []
    for name, value, stderr, own, unit, note, scale in zip(
        names, values, stderrs, ends, units, notes, scales, strict=True
    ):
        of = unit, None if unit == "1" else scale
        written = (
            words_of.quantity_with_error(value, stderr, *of),
            _interval(value, stderr, own, *of),
        )
        if note == "fixed":
            written = words_of.quantity(value, unit, 4), ""
        rows.append((words_of.without_unit(name), *written, note))
    columns = ["parameter", "value ± standard error", "90 % interval", "note"]
    if not any(notes):
        rows, columns = [row[:-1] for row in rows], columns[:-1]
    if "posterior_draws" in data:
        columns[1] = "mean ± standard deviation"
        columns += ["R-hat", "ESS bulk", "ESS tail"]
        chains = (data[name].values.tolist() for name in ("r_hat", "ess_bulk", "ess_tail"))
        more = [(f"{r:.3f}", f"{b:.0f}", f"{t:.0f}") for r, b, t in zip(*chains, strict=True)]
        rows = [(*row, *own) for row, own in zip(rows, more, strict=True)]
    yield Table(tuple(columns), tuple(rows[:most]))
    if most is not None and len(rows) > most:
        yield Paragraph(f"{len(rows) - most} more: to_dataframe() gives all.")


def _interval(
    value: float,
    stderr: float,
    own: tuple[float, float],
    unit: str,
    scale: tuple[float, str] | None,
) -> str:
    """The parameter's own interval where it has one, else the standard error's."""
    if not np.isnan(own).any():
        return words_of.between(*own, unit, scale)
    return words_of.interval(value, BAND_90 * stderr, unit, scale)


def _traction(data: xarray.Dataset) -> Table:
    """p and q over the cells with samples: pressures in one unit, and places."""
    is_scanned = np.ones(data.sizes["x"], bool)
    if "observed" in data:
        is_scanned = data["observed"].any("element").values
    x = data["x"].values[is_scanned]
    value, stderr = (data[name].values[:, is_scanned] for name in ("estimate", "estimate_stderr"))
    units = str(data["estimate"].attrs["units"])
    of_traction, of_place = words_of.best_unit(units, value), words_of.best_unit("m", x)
    rows = []
    for c, name in enumerate(data["component"].values.tolist()):
        peak, place = float(data["peak"][c]), float(data["peak_position"][c])
        error = float(stderr[c, int(np.argmin(np.abs(x - place)))])
        rms = float(np.sqrt(mean_known(value[c] ** 2)))
        half = BAND_90 * float(mean_known(stderr[c]))
        band = f"± {_in(of_traction, half)}" if np.isfinite(half) else "not known"
        dof = words_of.significant(float(data["resolved_dof"][c]))
        highest = words_of.quantity_with_error(peak, error, units, of_traction)
        rows.append((name, highest, _in(of_place, place), _in(of_traction, rms), band, dof))
    columns = ["", "highest", "at x", "rms", "90 % band, mean", "resolved degrees of freedom"]
    last = len(columns) - bool(np.isnan(data["resolved_dof"]).all())
    return Table(tuple(columns[:last]), tuple(row[:last] for row in rows))


def _unknown(data: xarray.Dataset) -> Table:
    """The unknown of a linear problem: its extremes with their standard errors, and its band."""
    value, stderr = (data[name].values for name in ("value", "value_stderr"))
    row = []
    for find in (np.argmin, np.argmax):
        at = np.unravel_index(int(find(value)), value.shape)
        own = words_of.quantity_with_error(float(value[at]), float(stderr[at]), "1")
        row.append(f"{own} at {', '.join(map(str, at))}")
    half = BAND_90 * float(mean_known(stderr))
    row.append(words_of.significant(float(np.sqrt(mean_known(value**2)))))
    row.append(f"± {words_of.significant(half)}" if np.isfinite(half) else "not known")
    row.append(words_of.significant(float(data["resolved_dof"])))
    columns = "lowest", "highest", "rms", "90 % band, mean", "resolved degrees of freedom"
    return Table(columns, (tuple(row),))


def _in(scale: tuple[float, str], value: float) -> str:
    factor, unit = scale
    return f"{words_of.significant(factor * value)} {unit}"


def _wrapped(paragraph: str, bullet: str = "") -> list[str]:
    indent = " " * len(bullet)
    own = printable(paragraph)
    return textwrap.wrap(own, WIDTH, initial_indent=bullet, subsequent_indent=indent)


def _table_lines(table: Table) -> list[str]:
    """Columns with two spaces between them, the headings underlined."""
    rows = [
        [_shortened(printable(str(each))) for each in row] for row in (table.columns, *table.rows)
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rows.insert(1, ["-" * width for width in widths])
    padded = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
    return ["", *(line[:WIDTH] for line in padded)]


def _shortened(cell: str) -> str:
    return cell if len(cell) <= _WIDEST_CELL else f"{cell[: _WIDEST_CELL - 1]}…"


def _html_table(table: Table) -> str:
    head = "".join(f'<th style="{_CELL}">{_escaped(each)}</th>' for each in table.columns)
    rows = (
        "".join(f'<td style="{_CELL}">{_escaped(str(each))}</td>' for each in row)
        for row in table.rows
    )
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _html_line(paragraph: str) -> str:
    return f"<p>{_escaped(paragraph)}</p>"


def _escaped(words: str) -> str:
    return str(markupsafe.escape(printable(words_of.typeset(words))))
