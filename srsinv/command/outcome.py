"""What became of a job."""

from dataclasses import dataclass

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
