"""The families of golden data: what cases each has, and what computes a case."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from tests.golden import forms, models, products, public, random_sets
from tests.golden.entries import Entries

DATA = Path(__file__).parent / "data"


class GoldenFamily(NamedTuple):
    """`cases()`: names; `entries(case)`: what the tree gives."""

    cases: Callable[[], list[str]]
    entries: Callable[[str], Entries]


FAMILIES = {
    "forms": GoldenFamily(forms.cases, forms.entries),
    "products": GoldenFamily(lambda: list(models.MODELS), products.entries),
    "public": GoldenFamily(lambda: list(public.SCRIPTS), public.entries),
    "random": GoldenFamily(random_sets.cases, random_sets.entries),
}


def cases() -> Iterator[str]:
    """FAMILY/CASE of everything."""
    return (f"{name}/{case}" for name, family in FAMILIES.items() for case in family.cases())


def entries(case: str) -> Entries:
    """What the tree gives of FAMILY/CASE."""
    family, _, name = case.partition("/")
    return FAMILIES[family].entries(name)


def file(case: str, data: Path = DATA) -> Path:
    """Where the golden data of FAMILY/CASE are."""
    return data / f"{case}.json"
