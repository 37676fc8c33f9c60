"""What is known of the mutations: which tests notice which, in tests/claims/results."""

import json
from collections.abc import Mapping
from typing import Any

from .run import TIERS
from .table import KINDS, ROOT, Mutation

PATH = ROOT / "tests" / "claims" / "results" / "mutations.json"

Result = Mapping[str, Any]


def result(mutation: Mutation, tier: str | None, noticed_by: list[str]) -> Result:
    """What was found of one: `tier` is the least that notices it, None where none does."""
    edit = {key: getattr(mutation, key) for key in ("kind", "symbol", "old", "new", "guards")}
    given = {"equivalent": mutation.equivalent} if mutation.equivalent else {}
    return {**edit, **given, "tier": tier, "noticed_by": noticed_by}


def is_of(record: Result | None, mutation: Mutation) -> bool:
    """Whether a result is one of this very edit."""
    return record is not None and all(
        record[key] == getattr(mutation, key) for key in ("symbol", "old", "new")
    )


def read() -> dict[str, Result]:
    """All results, by name."""
    return json.loads(PATH.read_text())["mutations"] if PATH.exists() else {}


def write(recorded: Mapping[str, Result], table: Mapping[str, Mutation]) -> None:
    """The results of what is in the table, and how many each tier notices."""
    current = {name: recorded[name] for name in sorted(recorded) if name in table}
    PATH.parent.mkdir(parents=True, exist_ok=True)
    PATH.write_text(json.dumps({"counts": counts(current), "mutations": current}, indent=1) + "\n")


def counts(recorded: Mapping[str, Result]) -> dict[str, dict[str, Any]]:
    """For guards and constants: how many there are, are noticed by each tier, by none, and by none
    as they change no result."""
    return {kind: _counts([e for e in recorded.values() if e["kind"] == kind]) for kind in KINDS}


def _counts(records: list[Result]) -> dict[str, int]:
    tiers = tuple(TIERS)  # each holds those before it
    noticed = {
        f"noticed_by_{tier}": sum(e["tier"] in tiers[: tiers.index(tier) + 1] for e in records)
        for tier in tiers
    }
    missed = [e for e in records if e["tier"] is None]
    equivalent = sum("equivalent" in e for e in missed)
    return {
        "mutations": len(records),
        **noticed,
        "equivalent": equivalent,
        "missed": len(missed) - equivalent,
    }
