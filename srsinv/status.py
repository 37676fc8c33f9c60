"""How a computation ended: one enumeration for inversions, fits, rules and contact."""

import enum


class Status(enum.StrEnum):
    """A result code; it equals its text, and `advice` says what to do about it.

    Numbers beside it (iterations, condition, distance to the minimum) are in the result's `stats`.
    """

    CONVERGED = "converged"
    GIVEN = "given"  # nothing was searched
    STEP_LIMIT = "not converged: step limit reached"
    STALLED = "not converged: stopped short of a minimum"
    NOT_FINITE = "not finite"
    ILL_CONDITIONED = "ill-conditioned"
    RANGE_END = "at an end of its range"
    NOT_SIGNIFICANT = "not above the noise"
    CHAINS_DIFFER = "not converged: the chains differ"

    @property
    def is_answer(self) -> bool:
        """Whether the computation ended as it should."""
        return self in (Status.CONVERGED, Status.GIVEN)

    @property
    def advice(self) -> str:
        """A sentence on what to do; empty for an answer."""
        return _ADVICE.get(self, "")


_ADVICE = {
    Status.STEP_LIMIT: "Allow more steps or a larger tolerance, or start nearer.",
    Status.STALLED: "Start elsewhere, or bound or fix what the data hardly determine.",
    Status.NOT_FINITE: "The model or its derivative is nan or infinite where the search stopped: "
    "bound the parameters to where it is defined.",
    Status.ILL_CONDITIONED: "Give larger weights or a stronger prior, or take path=spectral.",
    Status.RANGE_END: "Widen the range: the signal does not determine it within.",
    Status.NOT_SIGNIFICANT: "Take a longer scan, or another range.",
    Status.CHAINS_DIFFER: "Take more draws, or bound the parameters to one of several maxima.",
}
