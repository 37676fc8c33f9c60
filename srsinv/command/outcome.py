"""What became of a job."""

import sys
from dataclasses import dataclass

from ..errors import BadInput, printable

DONE, FAULT, REFUSED = 0, 1, 2


@dataclass(frozen=True)
class Outcome:
    """The exit code of a job, and in one sentence why it failed."""

    code: int
    reason: str = ""

    @property
    def is_done(self) -> bool:
        """Whether the job's results are in its folder."""
        return self.code == DONE


def say(refusal: BadInput) -> int:
    """Print a refusal as one line on standard error; the exit code that goes with it."""
    print("srsinv:", printable(" ".join(str(refusal).split())), file=sys.stderr)
    return REFUSED
