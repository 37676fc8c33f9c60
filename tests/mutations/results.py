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


def is_of(found: Result | None, mutation: Mutation) -> bool:
    """Whether a result is one of this very edit."""
    return found is not None and all(
        found[key] == getattr(mutation, key) for key in ("symbol", "old", "new")
    )


def read() -> dict[str, Result]:
    """All results, by name."""
    return json.loads(PATH.read_text())["mutations"] if PATH.exists() else {}


def write(found: Mapping[str, Result], table: Mapping[str, Mutation]) -> None:
    """The results of what is in the table, and how many each tier notices."""
    current = {name: found[name] for name in sorted(found) if name in table}
    PATH.parent.mkdir(parents=True, exist_ok=True)
    PATH.write_text(json.dumps({"counts": counts(current), "mutations": current}, indent=1) + "\n")


def counts(found: Mapping[str, Result]) -> dict[str, dict[str, Any]]:
    """For guards and constants: how many there are, are noticed by each tier, by none, and by none
    as they change no result."""
    return {kind: _counts([e for e in found.values() if e["kind"] == kind]) for kind in KINDS}


def _counts(found: list[Result]) -> dict[str, int]:
    tiers = tuple(TIERS)  # each holds those before it
    noticed = {
        f"noticed_by_{tier}": sum(e["tier"] in tiers[: tiers.index(tier) + 1] for e in found)
        for tier in tiers
    }
    missed = [e for e in found if e["tier"] is None]
    equivalent = sum("equivalent" in e for e in missed)
    return {
        "mutations": len(found),
        **noticed,
        "equivalent": equivalent,
        "missed": len(missed) - equivalent,
    }
