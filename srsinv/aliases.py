"""Aliases of renamed keys and classes, and the version until which the old names are supported."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Alias:
    """An old name and the new one; a `*` matches the same text in both.

    `until`: the version that no longer knows the old one.
    """

    old: str
    new: str
    until: str

    def newer(self, name: str) -> str | None:
        """The new name of an old one, None of any other."""
        return _translated(name, self.old, self.new)

    def older(self, name: str) -> str | None:
        """The old name of a new one, None of any other."""
        return _translated(name, self.new, self.old)


def _translated(name: str, pattern: str, wanted: str) -> str | None:
    match = re.fullmatch(re.escape(pattern).replace(r"\*", "(.*)"), name)
    return None if match is None else wanted.replace("*", "{}").format(*match.groups())


# Keys of `metrics.json`: both are written.
METRICS = (
    Alias("doubts_*", "warnings_*", "0.3.0"),
    Alias("sure_float*", "good_float*", "0.3.0"),
    Alias("sure_and_wrong_float*", "silent_failures_float*", "0.3.0"),
    Alias("told_*", "resolved_dof_*", "0.3.0"),
    Alias("result", "status", "0.3.0"),
    Alias("result_*", "status_*", "0.3.0"),
    Alias("rule_result_*", "rule_status_*", "0.3.0"),
    Alias("*time_s_first*", "*first_call_s*", "0.3.0"),
    Alias("*time_s_steady*", "*steady_call_s*", "0.3.0"),
    Alias("unseen_*", "holdout_chi2_*", "0.3.0"),
    Alias("not_told_from_nothing", "undetected_features", "0.3.0"),
    Alias("samples_lost", "samples_missing", "0.3.0"),
    Alias("short_of_distinct*", "snr_shortfall*", "0.3.0"),
    Alias("wavelength_kept_m", "resolved_wavelength_m", "0.3.0"),
    Alias("contact_share_*", "contact_fraction_*", "0.3.0"),
    Alias("*share_right*", "*fraction_right*", "0.3.0"),
    Alias("line_*_share", "line_*_explained_fraction", "0.3.0"),
    Alias("fit_*_found", "fit_*_converged", "0.3.0"),
    Alias("*_snr_db", "*_snr_dB", "0.3.0"),
)
# Keys of the configuration, in overrides and in YAML files: both are read.
KEYS = (
    Alias("*.snr_db", "*.snr_dB", "0.3.0"),
    Alias("hard_cases.cases.*.hard", "hard_cases.cases.*.label", "0.3.0"),
    Alias("fit.choose", "fit.select", "0.3.0"),
    Alias("ranking.drawn", "ranking.truth_ranges", "0.3.0"),
    Alias("fig12_ridges.distinct", "fig12_ridges.peak_over_noise", "0.3.0"),
    Alias("detection_limit.certainty", "detection_limit.relative_precision", "0.3.0"),
)
# Options of groups; the old one is a file that holds the new one.
OPTIONS = (Alias("amplifier=slow", "amplifier=charge_dc", "0.3.0"),)
# Classes that a user's own YAML files may name.
CLASSES = (
    Alias(
        "srsinv.forward.amplifier.SlowReadout", "srsinv.forward.amplifier.ChargeReadout", "0.3.0"
    ),
    Alias("srsinv.forward.effects.*", "srsinv.effects.*", "0.3.0"),
)


def with_old_names(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """`metrics`, each value under its old name too where that was another."""
    named = dict(metrics)
    for alias in METRICS:
        for key, value in metrics.items():
            if (old := alias.older(key)) is not None:
                named[old] = value
    return named


def current_name(name: str, table: tuple[Alias, ...]) -> str:
    """The new name of a name that may be an old one in `table`."""
    return next(filter(None, (alias.newer(name) for alias in table)), name)


def current_override(override: str) -> str:
    """An override as it was typed, with the new name of its key: that of a key above it, too."""
    key = re.match(r"[+~]*([\w./-]*)", override)
    assert key is not None  # the pattern takes nothing, too
    levels = key[1].split(".")
    for depth in range(len(levels), 0, -1):
        above = ".".join(levels[:depth])
        if (new := current_name(above, KEYS)) != above:
            return override.replace(above, new, 1)
    return override


def with_current_keys(node: Any, above: str = "") -> Any:
    """A tree of settings under the key `above`, with the new names of its keys. An old name comes
    from a user's own file and overrides the value under the new one."""
    if isinstance(node, list):
        return [with_current_keys(each, f"{above}{i}.") for i, each in enumerate(node)]
    if not isinstance(node, Mapping):
        return node
    named = {key: with_current_keys(each, f"{above}{key}.") for key, each in node.items()}
    for key in node:
        if (new := current_name(f"{above}{key}", KEYS)) != f"{above}{key}":
            named[new.rpartition(".")[2]] = named.pop(key)
    return named
