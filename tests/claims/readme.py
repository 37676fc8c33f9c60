"""Writes the parts of README and docs that hold measured numbers, from the results of the claims.

    python -m tests.claims.readme

A part stands between the comments `<!-- NAME: ... -->` and `<!-- end of NAME -->`; its words are in
readme/NAME.md.j2, which sees the summaries of studies by their names, their rows in `rows`, and the
commands, their rows by what they are called.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from srsinv.report.text import format_with_error
from tests.claims.study import RESULTS, read

ROOT = Path(__file__).resolve().parents[2]
TEMPLATES = Path(__file__).with_suffix("")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PART = re.compile(r"(<!-- (\w+): [^>]*-->\n).*?(<!-- end of \2 -->)", re.DOTALL)
Metrics = Mapping[str, Any]
SCALES = {"1": 1.0, "%": 100.0, "nm": 1e9, "um": 1e6, "uV": 1e6, "mm": 1e3, "ms": 1e3, "pC/N": 1e12}


def digits(value: float, unit: str = "1", figures: int = 2) -> str:
    """The value in the unit, with so many significant figures and no exponent."""
    scaled = SCALES[unit] * value
    places = figures - 1 - math.floor(math.log10(abs(scaled))) if scaled else 0
    return f"{round(scaled, places):.{max(places, 0)}f}"


def with_error(value: float, stderr: float, unit: str = "1") -> str:
    """Value and standard error in the unit."""
    return format_with_error(SCALES[unit] * value, SCALES[unit] * stderr)


def power(value: float) -> str:
    """One significant digit and an exponent, as 2e-4."""
    digit, exponent = f"{value:.0e}".split("e")
    return f"{digit}e{int(exponent)}" if value else "0"


def duration(seconds: float) -> str:
    """For a reader who wonders whether to wait."""
    minutes = seconds / 60
    return f"{5 * math.ceil(seconds / 5)} s" if minutes < 1 else f"{round(minutes, 0):.0f} min"


def span(metrics: Metrics, ending: str, unit: str = "1") -> str:
    """From the least to the greatest of those whose name ends so."""
    values = [SCALES[unit] * value for name, value in metrics.items() if name.endswith(ending)]
    places = max(1 - math.floor(math.log10(min(values))), 0)
    return f"{min(values):.{places}f} to {max(values):.{places}f}"


def by_noise(metrics: Metrics, name: str) -> str:
    """Percent at 20, 40 and 60 dB."""
    return ", ".join(digits(metrics[f"{name}_{level}_dB"], "%") for level in (20, 40, 60))


def where(rows: Sequence[Metrics], **labels: Any) -> list[Metrics]:
    """The rows with these labels."""
    return [row for row in rows if all(row[name] == each for name, each in labels.items())]


def by(rows: Sequence[Metrics], name: str) -> dict[Any, Metrics]:
    """The rows by one of their labels."""
    return {row[name]: row for row in rows}


def boards(metrics: Mapping[str, Metrics], name: str) -> dict[str, float]:
    """Of the pitches [m] of a board's recordings: the weighted mean, spread, mean standard error
    and the chi-square about the mean."""
    own = [each for key, each in metrics.items() if key.startswith(name)]
    pitch, stderr = (np.array([m[key] for m in own]) for key in ("pitch_m", "pitch_m_stderr"))
    mean = np.average(pitch, weights=stderr**-2)
    summary = {"mean": mean, "spread": pitch.std(ddof=1), "stderr": stderr.mean()}
    return {**summary, "chi2": np.sum(((pitch - mean) / stderr) ** 2)}


def other_lines(metrics: Metrics, shortest_m: float = 4e-3) -> str:
    """The wavelengths [mm] of a recording's other lines, those below `shortest_m` unnamed."""
    wavelengths = [metrics[f"line_{n}_m"] for n in range(1, metrics["lines"] + 1)]
    shown = [
        digits(each, "mm", 4 if each > 0.01 else 3) for each in wavelengths if each > shortest_m
    ]
    words = [*shown, *["and shorter ones"] * (len(shown) < len(wavelengths))]
    return ", ".join(words) or "none"


def environment() -> Environment:
    """The templates of the parts with the results and what they are written by."""
    env = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    summaries = {path.stem: json.loads(path.read_text("utf-8")) for path in RESULTS.glob("*.json")}
    rows = {path.stem: read(path.stem) for path in RESULTS.glob("*.jsonl")}
    commands = by(rows["commands"], "command")
    metrics = {name: each["metrics"] for name, each in commands.items()}
    written = (digits, with_error, power, duration, span, by_noise, where, by)
    env.filters |= {each.__name__: each for each in written}
    env.globals |= {**summaries, "rows": rows, "commands": commands, "metrics": metrics}
    env.globals |= {"other_lines": other_lines}
    env.globals |= {"boards": partial(boards, metrics)}
    return env


def renewed(text: str, env: Environment) -> str:
    """The text with its parts as the results have them."""

    def part(match: re.Match[str]) -> str:
        words = env.get_template(f"{match[2]}.md.j2").render()
        return f"{match[1]}\n{words.strip()}\n\n{match[3]}"

    return PART.sub(part, text)


def stale() -> dict[Path, str]:
    """The pages that do not say what the results do, with what they should say."""
    env = environment()
    pages = {path: path.read_text(encoding="utf-8") for path in PAGES}
    new = {path: renewed(text, env) for path, text in pages.items()}
    return {path: text for path, text in new.items() if text != pages[path]}


def write() -> None:
    """Write what is stale."""
    for page, text in stale().items():
        page.write_text(text, encoding="utf-8")
        print(f"wrote {page.relative_to(ROOT)}")


if __name__ == "__main__":
    write()
