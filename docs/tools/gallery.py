"""The experiments' cards: their command, their finding and one figure each, kept in
`docs/stored/gallery`.

    python -m docs.tools.gallery [NAME ...]
"""

import html
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

STORED = Path(__file__).parents[1] / "stored" / "gallery"
COMMANDS = Path(__file__).with_suffix(".yaml")
SHARED = Path(__file__).parents[3] / "shared" / "recordings"


@dataclass(frozen=True)
class Card:
    """A run of an experiment: what was typed after `srsinv`, its title, the description of its
    figure, and the names of its metrics with their units."""

    name: str
    command: str
    finding: str
    figure: str
    metrics: list[list[str]]


def cards() -> list[Card]:
    """The stored cards, as gallery.yaml lists them."""
    files = [STORED / f"{name}.json" for name in yaml.safe_load(COMMANDS.read_text("utf-8"))]
    return [Card(**json.loads(path.read_text("utf-8"))) for path in files if path.exists()]


def run(name: str, command: str, figure: str | None, folder: Path) -> Card:
    """Run an experiment in a folder, and keep its figure."""
    import xarray

    for path in SHARED.rglob("*.csv"):
        if path.name in command:
            shutil.copyfile(path, folder / path.name)
    target = "hydra.sweep.dir=run" if command.startswith("-m ") else "hydra.run.dir=run"
    _srsinv([*shlex.split(command), target, "figures=all"], folder)
    page, results = (
        next(each for stem in stems if (each := folder / "run" / stem).exists())
        for stems in (("report.html", "sweep.html"), ("result.nc", "sweep.nc"))
    )
    with xarray.open_dataset(results) as data:
        patterns = {
            str(each.attrs["metric"]): str(each.attrs.get("units", ""))
            for each in data.variables.values()
            if "metric" in each.attrs
        }
    heading = re.search(r"<h1[^>]*>(.*?)</h1>", page.read_text("utf-8"), re.DOTALL)
    finding = "" if heading is None else html.unescape(re.sub(r"<[^>]+>", "", heading[1]).strip())
    pictures = sorted((folder / "run" / "figures").glob("*.png"))
    chosen = next((path for path in pictures if figure and figure in path.stem), None)
    chosen = chosen or next(iter(pictures), None)
    (STORED / f"{name}.png").unlink(missing_ok=True)
    if chosen is not None:
        shutil.copyfile(chosen, STORED / f"{name}.png")
    label = "" if chosen is None else chosen.stem.replace("_", " ")
    return Card(name, command, finding, label, [list(each) for each in sorted(patterns.items())])


def _srsinv(arguments: list[str], folder: Path) -> None:
    done = subprocess.run(
        ["srsinv", *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"srsinv {shlex.join(arguments)}: {done.stderr}")


def main(names: list[str]) -> None:
    """Run the experiments of these names, all without one."""
    STORED.mkdir(parents=True, exist_ok=True)
    commands = yaml.safe_load(COMMANDS.read_text("utf-8"))
    for name, entry in commands.items():
        if names and name not in names:
            continue
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            _srsinv(["experiment=example_recording", "hydra.run.dir=example"], Path(folder))
            card = run(name, entry["command"], entry.get("figure"), Path(folder))
        path = STORED / f"{name}.json"
        path.write_text(json.dumps(asdict(card), indent=1, ensure_ascii=False) + "\n", "utf-8")
        print(f"{name}: {time.perf_counter() - began:.0f} s: {card.finding}", flush=True)


if __name__ == "__main__":
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    main(sys.argv[1:])
