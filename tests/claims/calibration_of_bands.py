"""Ranks of truths by every method, over as many draws as find an error of a few per cent (an
hour), and by rules that do not choose weights for bands (a minute)."""

from srsinv.jobs.trials import Row
from tests.claims.study import Study
from tests.jobs.run import outcome

QUICK, SLOW, OF_A_RULE = 1000, 100, 400
INVERSIONS = (
    "Wiener", "Tikhonov", "Wiener evidence", "Wiener correlation", "Wiener iterative",
    "Tikhonov gcv", "Tikhonov upre",
)  # fmt: skip
QUICK_METHODS = (
    *INVERSIONS,
    "Wiener, bands too narrow on purpose",
    "Wiener, open with gaps",
    "Wiener iterative, open with gaps",
    "Wiener, noise estimated",
    "Live, lag of two depths",
    "LinearProblem, direct",
    "LinearProblem, spectral",
    "Fit of strip load",
    "Pitch of a board",
    "srsinv.fit",
    "Wiener, known friction",
)
SLOW_METHODS = (
    "Tikhonov, open with gaps",
    "Wiener evidence, open with gaps",
    "Wiener correlation, open with gaps",
    "Tikhonov gcv, open with gaps",
    "Tikhonov upre, open with gaps",
    "Wiener, admissible",
    "Fit of a ridge",
    "Calibration of a rig",
    "Semi-blind",
    "Direction of a ridge",
    "srsinv.sample (NUTS)",
    "Passes to and fro",
    "Passes to and fro, noise estimated",
    "Passes of a stage that is off",
    "Wiener, tolerances",
    "Fit of strip load, tolerances",
    "Wiener, measured kernel",
    "Theory of a measured kernel",
)
OTHER_RULES = ("aicc", "discrepancy", "l_curve", "ncp", "quasi_optimality")


def measured(method: str, draws: int, rule: str = "evidence") -> Row:
    """The p-value of a method's ranks, and the coverage of its 90 % bands."""
    own = "calibration_of_bands"
    metrics = outcome(
        f"experiment={own}", f"rule={rule}", f"{own}.methods=['{method}']",
        f"{own}.draws={draws}", f"{own}.slow_draws={draws}", f"{own}.conformal.repeats=4",
    ).dataset  # fmt: skip
    return {
        "p_value": float(metrics["p_value"][0]),
        "coverage": float(metrics["coverage"][0]),
        "least_coverage": float(metrics["coverage_of_quantity"].min()),
    }


def cases() -> list[dict]:
    """Every method, and Tikhonov's with the other rules."""
    return [
        *({"method": each, "draws": QUICK} for each in QUICK_METHODS),
        *({"method": each, "draws": SLOW} for each in SLOW_METHODS),
        *({"method": "Tikhonov", "draws": OF_A_RULE, "rule": each} for each in OTHER_RULES),
    ]


STUDY = Study("calibration_of_bands", measured, cases)
