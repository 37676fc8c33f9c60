"""The pages that nobody writes: API, configuration, metrics and gallery, from what they describe.

They are made anew at each build, from docstrings, from the files of `configs/` with their comments,
and from the runs that docs/tools/gallery.py has stored.
"""

import inspect
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from sphinx.util import logging

import srsinv
from srsinv import kinds, plot
from srsinv.command.help import experiments, groups

from .gallery import STORED, Card, cards
from .keys import Key, own_keys, read_groups, undocumented

LOGGER = logging.getLogger(__name__)
CONFIGS = Path(__file__).parents[2] / "configs"
TEXTS = {"quality", "path", "status", "warnings", "cause", "undetermined"}  # metrics that are words
UNITS_WITHIN = {each: each for each in ("m", "s", "Pa", "V", "Hz", "dB", "rad", "bytes")} | {
    "deg": "°"
}
LINK = re.compile(r"\[`([^`\]]+)`\]\[([^\]]*)\]")
PUBLIC = {
    **{name: f"srsinv.{name}" for name in dir(srsinv)},
    **{name: f"srsinv.kinds.{name}" for name in dir(kinds) if not hasattr(srsinv, name)},
}


def write(docs: Path) -> None:
    """Write the generated pages below the folder `docs`."""
    runs = cards()
    pages = {
        "reference/api.md": api(),
        "reference/kinds.md": kinds_page(),
        "reference/plot.md": plot_page(),
        "reference/configuration.md": configuration(),
        "reference/experiments.md": experiment_keys(),
        "reference/metrics.md": metrics(runs),
        "gallery/index.md": gallery(runs),
    }
    for name, text in pages.items():
        path = docs / name
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, encoding="utf-8")


# --- API --------------------------------------------------------------------------------------


def api() -> str:
    """`dir(srsinv)`: functions, classes, and the modules among them by their pages."""
    values = {name: getattr(srsinv, name) for name in dir(srsinv)}
    parts = [
        "# Python API",
        "Everything public in `srsinv`. Values are in SI units, arrays are numpy's or JAX's. "
        "Base classes for parts that you write stand in [kinds](kinds.md), figures in "
        "[plot](plot.md).",
        "## Functions",
        *(entry("srsinv", n, v) for n, v in values.items() if inspect.isfunction(v)),
        "## Classes",
        *(entry("srsinv", n, v) for n, v in values.items() if inspect.isclass(v)),
        "## Modules",
    ]
    for name, value in values.items():
        if inspect.ismodule(value):
            parts.append(f"### srsinv.{name}\n\n{_words(value)}")
            if name not in ("kinds", "plot"):
                own = [n for n in dir(value) if inspect.isfunction(getattr(value, n, None))]
                parts += [
                    entry(f"srsinv.{name}", n, getattr(value, n))
                    for n in own
                    if not n.startswith("_") and getattr(value, n).__module__ == value.__name__
                ]
    return _page(parts)


def kinds_page() -> str:
    """`srsinv.kinds`: the bases of parts."""
    own = [(name, getattr(kinds, name)) for name in dir(kinds)]
    parts = ["# Kinds of parts", _words(kinds), *(entry("srsinv.kinds", *each) for each in own)]
    return _page(parts)


def plot_page() -> str:
    """`srsinv.plot`: the figures of pages."""
    own = [(n, v) for n in dir(plot) if callable(v := getattr(plot, n)) and n[0] != "_"]
    return _page(["# Figures", _words(plot), *(entry("srsinv.plot", *each) for each in own)])


def entry(module: str, name: str, value: Any) -> str:
    """A class or a function with its docstring, and a class's methods and properties with
    theirs."""
    kind = "class" if inspect.isclass(value) else "function"
    options = "" if _is_home(module, name) else ":no-index:\n"
    body = _words(value)
    if kind == "class":
        body = "\n\n".join([body, *_members(value)])
    return f"````{{py:{kind}}} {module}.{name}{_signature(value)}\n{options}\n{body}\n````"


def _is_home(module: str, name: str) -> bool:
    return PUBLIC.get(name, f"{module}.{name}") == f"{module}.{name}"


def _members(owner: type) -> Iterator[str]:
    """The public methods and properties that the package documents, of the class and its bases."""
    seen: set[str] = set()
    for base in owner.__mro__:
        if not base.__module__.startswith("srsinv"):
            continue
        for name, member in vars(base).items():
            if name in seen or (name.startswith("_") and name != "__call__"):
                continue
            seen.add(name)
            if isinstance(member, property):
                words = _words(member)
                if words:
                    yield f"```{{py:property}} {name}\n:no-index:\n\n{words}\n```"
            elif inspect.isfunction(getattr(owner, name, None)) and inspect.getdoc(
                getattr(owner, name)
            ):
                function = getattr(owner, name)
                if function.__module__.startswith("srsinv"):
                    signature = _signature(function, skip_self=True)
                    yield (
                        f"```{{py:method}} {name}{signature}\n:no-index:\n\n{_words(function)}\n```"
                    )


def _signature(value: Any, skip_self: bool = False) -> str:
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return "()"
    plain = [
        parameter.replace(annotation=inspect.Parameter.empty, default=_default(parameter.default))
        for parameter in signature.parameters.values()
    ]
    plain = plain[1:] if skip_self and plain and plain[0].name == "self" else plain
    return str(signature.replace(parameters=plain, return_annotation=inspect.Signature.empty))


class _Written:
    def __init__(self, text: str):
        self.text = text

    def __repr__(self) -> str:
        return self.text


def _default(value: Any) -> Any:
    if value is inspect.Parameter.empty:
        return value
    text = repr(value)
    return _Written(text if len(text) < 40 and "<" not in text else "...")


def _words(value: Any) -> str:
    """A docstring as MyST, its references to public names as links."""

    def link(match: re.Match[str]) -> str:
        name = match[1]
        return f"{{py:obj}}`{name} <{PUBLIC[name]}>`" if name in PUBLIC else f"`{name}`"

    return LINK.sub(link, inspect.getdoc(value) or "")


# --- configuration ------------------------------------------------------------------------------


def configuration() -> str:
    """Every key of the configuration but those of experiments, by group."""
    keys = read_groups(CONFIGS)
    missing = undocumented(CONFIGS)
    if missing:
        LOGGER.warning("keys without a comment in configs/: %s", ", ".join(missing))
    parts = [
        "# Configuration",
        "Type a key as `key=value` behind `srsinv`, an option of a group as `group=option`. "
        "`srsinv --cfg job` shows the composed configuration. The keys of one experiment stand in "
        "[experiments](experiments.md). A default of `null` means that nothing is given, one of "
        "`???` that the key must be given.",
        "## General",
        _table(keys["."]["config"]),
    ]
    for group, options in groups(CONFIGS).items():
        parts.append(f"## {group}")
        chosen = keys[group]
        parts.append(f"Options: {', '.join(f'`{group}={option}`' for option in options)}.")
        for option in options:
            own = chosen[option]
            parts += [f"### {group}={option}", own[0].file_comment if own else ""]
            parts.append(_table(own) or "It has no keys.")
    return _page(parts)


def experiment_keys() -> str:
    """Every experiment with the keys that it sets."""
    parts = [
        "# Experiments and their keys",
        "`srsinv experiment=NAME` runs one. Each table has the keys that the experiment sets: its "
        "own, and those of groups whose default differs.",
    ]
    for each in experiments(CONFIGS):
        parts.append(f"## {each.name}")
        parts.append(f"{each.summary}\n\n```text\nsrsinv experiment={each.name}\n```")
        parts.append(_table(own_keys(CONFIGS, each.name)))
    return _page(parts)


def _table(keys: Iterable[Key]) -> str:
    rows = [f"| `{k.name}` | `{k.default}` | {k.unit} | {_cell(k.comment)} |" for k in keys]
    if not rows:
        return ""
    return "\n".join(["| key | default | unit | meaning |", "|---|---|---|---|", *rows])


def _cell(text: str) -> str:
    return text.replace("|", r"\|").replace("<", r"\<").replace("*", r"\*")


# --- metrics and gallery ------------------------------------------------------------------------


def metrics(runs: Iterable[Card]) -> str:
    """What each experiment writes into metrics.json, with units."""
    parts = [
        "# Metrics",
        "The keys of `metrics.json` by experiment. Names in braces stand for a label, such as a "
        "component (`p`, `q`), a method or a parameter. Units are SI.",
    ]
    for run in runs:
        rows = [f"| `{name}` | {_unit_of_metric(name, unit)} |" for name, unit in run.metrics]
        parts += [f"## {run.name}", "\n".join(["| metric | unit |", "|---|---|", *rows])]
    return _page(parts)


def _unit_of_metric(name: str, unit: str) -> str:
    """The unit of a metric, also of those that are words or have it within their name."""
    words = name.split("_")
    if words[0] in TEXTS:
        return "text"
    if "per" in words:
        return "1/Pa²" if "Pa2" in words else unit
    within = [UNITS_WITHIN[word] for word in words[1:] if word in UNITS_WITHIN]
    return within[-1] if unit == "1" and within else unit


def gallery(runs: Iterable[Card]) -> str:
    """A card for each experiment: figure, command, finding."""
    body = "\n\n".join(map(_card, runs))
    return _page(
        [
            "# Gallery",
            "Every experiment with one of its figures, its command and what it found. The command "
            "leaves the whole page, with all figures, numbers and assumptions.",
            f"`````{{grid}} 1 1 2 2\n:gutter: 3\n\n{body}\n`````",
        ]
    )


def _card(run: Card) -> str:
    figure = f":img-top: ../stored/gallery/{run.name}.png\n:img-alt: {run.figure}\n"
    has_figure = (STORED / f"{run.name}.png").exists()
    return (
        f"````{{grid-item-card}} {run.name}\n{figure if has_figure else ''}\n{run.finding}\n\n"
        f"```text\nsrsinv {run.command}\n```\n````"
    )


def _page(parts: Iterable[str]) -> str:
    return "\n\n".join(part for part in parts if part).rstrip() + "\n"
