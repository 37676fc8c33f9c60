"""How readable the project's words are: lengths of sentences, semicolons, and words to avoid.

    python -m tests.house.prose [FILE ...]      what is beyond the rules, file by file

`prose.yaml` has the rules: words that are not used, and how many exceptions are left.
"""

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
RULES = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))
LONGEST = 35  # words of a sentence
SEMICOLONS = 3  # of a paragraph
GENERATED = {"api", "configuration", "experiments", "kinds", "metrics", "plot"}

FENCE = re.compile(r"^(```+|~~~+|:::+).*?^\1", re.DOTALL | re.MULTILINE)
DROPPED = [
    (re.compile(r"\A---\n.*?\n---\n", re.DOTALL), ""),  # front matter
    (re.compile(r"<!--.*?-->|\{#.*?#\}", re.DOTALL), ""),
    (re.compile(r"\{%.*?%\}", re.DOTALL), " "),
    (re.compile(r"\{\{.*?\}\}", re.DOTALL), "VALUE"),
    (re.compile(r"\$\$.*?\$\$", re.DOTALL), " FORMULA "),
    (re.compile(r"\$[^$\n]+\$"), "FORMULA"),
    (re.compile(r"`[^`\n]+`"), "CODE"),
    (re.compile(r"\[([^\]]*)\]\([^)]*\)"), r"\1"),
]
BLOCK = re.compile(r"\n\s*\n|\n(?=\s*[-*|#:]|\s*\d+\.\s)")
END = re.compile(r"(?<=[.!?:;])\s+(?=[A-Z0-9*(])|(?<=[.!?])\s+")


def pages() -> list[Path]:
    """What a person reads before and while using srsinv, but what is generated."""
    docs = [
        path
        for path in (ROOT / "docs").rglob("*.md")
        if "_build" not in path.parts and path.stem not in GENERATED
    ]
    templates = [
        path
        for folder in ("srsinv/report/pages", "experiments")
        for path in (ROOT / folder).rglob("*.md.j2")
    ]
    return sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *docs, *templates])


def sources() -> list[Path]:
    """Pages, and files whose words reach a reader: code, configurations, templates."""
    endings = {".py", ".yaml", ".md", ".j2"}
    own = [
        path
        for folder in ("srsinv", "experiments", "configs", "benchmarks", "docs/tools")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in endings
    ]
    return sorted({*own, *pages()})


def paragraphs(text: str) -> Iterator[str]:
    """The paragraphs and items of a page, without code, formulas and tables."""
    text = FENCE.sub("\n", text)
    for pattern, put in DROPPED:
        text = pattern.sub(put, text)
    for block in BLOCK.split(text):
        words = " ".join(block.split())
        if words and not words.startswith(("|", "#", "```")):
            yield words


def sentences(text: str) -> list[str]:
    """The sentences of a page."""
    return [each for p in paragraphs(text) for each in END.split(p) if len(each.split()) > 1]


def too_long(text: str) -> list[str]:
    """Sentences of more than `LONGEST` words."""
    return [each for each in sentences(text) if len(each.split()) > LONGEST]


def too_many_semicolons(text: str) -> list[str]:
    """Paragraphs of more than `SEMICOLONS` semicolons."""
    return [each for each in paragraphs(text) if each.count(";") > SEMICOLONS]


def avoided(text: str) -> list[str]:
    """The phrases of the rules that a file holds, across line ends."""
    flat = " ".join(text.split()).lower()
    return [each for each in RULES["avoided"] if re.search(rf"\b{re.escape(each.lower())}\b", flat)]


def mean_length(paths: Iterable[Path]) -> float:
    """Mean number of words of the pages' sentences."""
    lengths = [len(each.split()) for path in paths for each in sentences(path.read_text("utf-8"))]
    return sum(lengths) / len(lengths)


def main(names: list[str]) -> None:
    """Print what is beyond the rules."""
    for path in [Path(name).resolve() for name in names] or sources():
        text = path.read_text("utf-8")
        found = [("words", each) for each in avoided(text)]
        if path.name.endswith((".md", ".md.j2")):
            found += [("long", each) for each in too_long(text)]
            found += [("semicolons", each) for each in too_many_semicolons(text)]
        for kind, each in found:
            print(f"{path.relative_to(ROOT)}: {kind}: {each[:200]}")


if __name__ == "__main__":
    main(sys.argv[1:])
