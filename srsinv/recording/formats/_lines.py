"""The lines of a text, in blocks: no row of endless length, no comments, nothing that only pads."""

import io
import re
from collections.abc import Iterator

from srsinv.errors import BadInput

from ._heading import is_comment

LONGEST_ROW = 2**18  # characters: a thousand names of two hundred, with their commas
BLOCK = 2**20  # characters whose cells are turned into numbers together
_MARKED = re.compile(r"(?m)^[ \t]*[#%/!;]")  # a line that may be a comment
_MOST_COMMENTS = 1_000  # that differ: any further one is taken as a row
_PADDING = "\0\x1a\n"  # at a text's end, by DOS and by loggers that write whole blocks


class Lines(Iterator[str]):
    """Lines of a text, read in blocks.

    Raises `BadInput` where the lines since the last row's end are longer than `LONGEST_ROW`: a row
    may take several, where one of its cells does.
    """

    def __init__(self, name: str, text: io.TextIOWrapper):
        self._name, self._text = name, text
        self._begun, self._block, self._at = "", "", 0
        self._rows, self._characters = 0, 0
        self._number = 1  # of the first line of the block
        self._delimiter: str | None = None  # where comments are left out
        self.comments: dict[int, str] = {}  # the first of each, by its line's number

    def begin_after(self, rows: int) -> None:
        """Begin the next row, after `rows` of them."""
        self._rows, self._characters = self._rows + rows, 0

    def skip(self, lines: int) -> None:
        """Take so many lines as read, and begin the first row."""
        for _ in range(lines):
            next(self)
            self.begin_after(0)
        self.begin_after(1)

    def leave_out_comments(self, delimiter: str) -> None:
        """Read on without lines that begin with a comment's mark."""
        self._delimiter = delimiter
        self._number -= self._block.count("\n", self._at)
        self._block, self._at = self._without_comments(self._block[self._at :]), 0

    def _without_comments(self, block: str) -> str:
        """The lines of the next block that are rows."""
        number, self._number = self._number, self._number + block.count("\n")
        may_have = self._delimiter is not None and any(mark in block for mark in "#%/!;")
        if self._delimiter is None or not may_have or not _MARKED.search(block):
            return block
        rows, known = [], set(self.comments.values())
        for at, line in enumerate(block.split("\n"), number):
            if not is_comment(line, self._delimiter):
                rows.append(line)
            elif line not in known and len(known) < _MOST_COMMENTS:
                known.add(line)
                self.comments[at] = line
            elif line not in known:
                rows.append(line)
        return "\n".join(rows)

    def has_more_at_hand(self) -> bool:
        """Whether a line is buffered."""
        return self._at < len(self._block)

    def block_at_hand(self) -> str:
        """All buffered lines, read if there are none; empty at the end of the text."""
        if not self.has_more_at_hand():
            self._fill()
        return self._block[self._at :]

    def pass_over(self) -> None:
        """Take all buffered lines as read."""
        self._at = len(self._block)

    def __next__(self) -> str:
        if not self.has_more_at_hand():
            self._fill()
        if not self.has_more_at_hand():
            raise StopIteration
        begin, self._at = self._at, self._block.find("\n", self._at) + 1 or len(self._block)
        self._characters += self._at - begin
        if self._characters > LONGEST_ROW:
            raise self.too_long()
        return self._block[begin : self._at]

    def too_long(self) -> BadInput:
        """The refusal of the row that was begun last."""
        where = f"data row {self._rows}" if self._rows else "the header"
        return BadInput(
            f"{self._name}: {where} exceeds {LONGEST_ROW} characters, or one of its cells "
            "half of that: write a row for each sample, and close every quotation mark."
        )

    def _fill(self) -> None:
        """Buffer lines, unless the text is at its end."""
        read, self._block, self._at = " ", "", 0
        while read and not self._block:
            read = self._text.read(BLOCK)
            if "\0" in read or "\x1a" in read:
                read = self._without_padding(read)
            lines, end, self._begun = (self._begun + read).rpartition("\n")
            self._block = self._without_comments(lines + end)
            # The last line needs no end; nor is the end of one read that is too long already.
            if self._begun and (not read or len(self._begun) > LONGEST_ROW):
                self._block += self._begun if read else self._without_comments(self._begun)
                self._begun = ""

    def _without_padding(self, read: str) -> str:
        """The text's last characters, without the Ctrl-Z or the zeros that fill its last block.

        Raises `ValueError` where these are not at its end, stand in place of a row's end, or go on
        for more than a block, which no logger fills.
        """
        held, rest = read.rstrip(_PADDING), self._text.read(BLOCK)
        is_cut = read[len(held) :].startswith("\0") and bool(held or self._begun)
        goes_on = bool(rest.strip(_PADDING) or self._text.read(1))
        if is_cut or goes_on or not {"\0", "\x1a"}.isdisjoint(held):
            raise ValueError("binary")
        return held
