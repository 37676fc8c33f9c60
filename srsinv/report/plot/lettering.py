"""Text on a figure as it was written: a name from a file is never a formula.

matplotlib parses text between two dollar signs as mathematics, and fails on other text. Only the
formulae below are meant as such.
"""

import functools
import re
import textwrap
from collections.abc import Iterator

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.gridspec import SubplotSpec
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter

from ..text import typeset

SYMBOLS = {
    "mu": r"$\mu$",
    "sigma_x": r"$\sigma_x$",
    "sigma_z": r"$\sigma_z$",
    "tau_xz": r"$\tau_{xz}$",
    "sigma_y": r"$\sigma_y$",
}
SIGN_CONVENTION = r"$\sigma_z=-p,\ \tau_{xz}=-q$"
_FORMULAE = re.compile("(" + "|".join(map(re.escape, (*SYMBOLS.values(), SIGN_CONVENTION))) + ")")
_DOLLAR = re.compile(r"(?<!\\)\$")
_LONGEST_LINE = 128  # characters, as many as the figure is wide
_LONGEST_LABEL = 38  # of a legend or an axis, which takes room from the panels
_NO_GLYPH = "\ufffd"


def show_as_written(figure: Figure) -> None:
    """Show every text of the figure as given, cut short and without the characters that the font
    lacks; the formulae of this module stay formulae."""
    for text, longest in _texts(figure, _LONGEST_LINE):
        words = _drawable(_in_lines(text.get_text(), longest), longest)
        has_formula = bool(_FORMULAE.search(words))
        text.set_parse_math(has_formula)
        text.set_text(_escaped(words) if has_formula else words)
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            _letter_ticks(axis)


def _texts(artist: Artist, longest: int) -> Iterator[tuple[Text, int]]:
    """The texts within an artist, each with its longest line; ticks have theirs at drawing only."""
    if isinstance(artist, Legend):
        longest = _LONGEST_LABEL
    elif isinstance(artist, Axes) and (place := artist.get_subplotspec()):
        longest = int(_LONGEST_LINE * _share_of_width(place))
    for child in artist.get_children():
        if isinstance(child, Text):
            yield child, longest
        elif isinstance(child, Axis):
            yield child.label, longest
        else:
            yield from _texts(child, longest)


def _share_of_width(place: SubplotSpec) -> float:
    """The share of the figure's width that a panel has."""
    ratios = np.asarray(place.get_gridspec().get_width_ratios(), float)
    return float(ratios[place.colspan.start : place.colspan.stop].sum() / ratios.sum())


def _letter_ticks(axis: Axis) -> None:
    """Ticks that are named, not numbered."""
    if not isinstance(axis.get_major_locator(), FixedLocator):
        return
    if not isinstance(axis.get_major_formatter(), FuncFormatter):
        return
    names = [label.get_text() for label in axis.get_ticklabels()]
    lettered = [_escaped(_drawable(name, _LONGEST_LABEL)) for name in names]
    if lettered != names:
        axis.set_ticklabels(lettered)


def _escaped(text: str) -> str:
    """`text` with every dollar sign as such that is not part of one of the formulae."""
    parts = _FORMULAE.split(text)
    return "".join(part if i % 2 else _DOLLAR.sub(r"\\$", part) for i, part in enumerate(parts))


def _in_lines(text: str, longest: int) -> str:
    """A text of several words that is too long for a line, as two lines."""
    if len(text) <= longest or "\n" in text or _FORMULAE.search(text):
        return text
    first, *rest = textwrap.wrap(text, longest, break_long_words=False, break_on_hyphens=False)
    return "\n".join([first, " ".join(rest)]) if rest and len(first) <= longest else text


def _drawable(text: str, longest: int) -> str:
    """`text` in the font's characters, no line of it longer than `longest`, powers and signs
    typeset."""
    glyphs, text = _glyphs(), typeset(text)
    return "\n".join(
        "".join(each if ord(each) in glyphs else _NO_GLYPH for each in line)
        if len(line) <= longest
        else _drawable(f"{line[: longest - 1]}…", longest)
        for line in text.split("\n")
    )


@functools.cache
def _glyphs() -> frozenset[int]:
    """The characters of the font that figures are drawn with."""
    return frozenset(get_font(findfont(FontProperties())).get_charmap())
