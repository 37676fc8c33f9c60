"""Any recording, in any surroundings: a command ends with results of a stated quality, or with one
sentence, in time and without a traceback."""

import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from srsinv.__main__ import main
from tests.jobs import odd_columns
from tests.shared import SHARED, needs_shared

ROOT = Path(__file__).resolve().parents[2]
LAB_FILES = SHARED / "lab_files"
MOST_S = 120  # on a machine that does other things, too
FIXED = ("method=[tikhonov]", "method.tikhonov.weight_p=1e-7", "method.tikhonov.weight_q=1e-7")
RIDGE = ("feature=ridge", "feature.ridge.edge_length_m=1e-4", "recording.nominal_pressure_Pa=2e4")
# Under a shallow film, as a kernel wants six depths on both sides; with little that is fitted, as
# the signals are no ridge's and a search for all of a rig takes minutes.
NARROW = (
    "sensor.depth_m=3e-4",
    "fit.hold={height_m: 2e-5, width_m: 2e-4, position_m: 2e-3, base_friction: 0.5, depth_m: 3e-4}",
    "fit.free=[gain_1,gain_2]",
    "kernel.parameters=[]",
)
COMMANDS = {
    "inspect": ("experiment=inspect_recording",),
    "invert": ("experiment=invert_recording", *FIXED),
    "invert with gaps": ("experiment=invert_recording", *FIXED, "recording.missing=allow"),
    "fit": ("experiment=fit_recording",),
    "fit a ridge": ("experiment=fit_recording", *RIDGE),
    "calibrate": ("experiment=calibrate", *RIDGE, "fit.hold={height_m: 2e-5, width_m: 2e-3}"),
    "measure a kernel": ("experiment=measure_kernel", *RIDGE, *NARROW),
    "compare": ("experiment=compare", *FIXED),
}
EVERY = [(file, command) for command in COMMANDS for file in odd_columns.ODD]
# Of those of the first tier most are refused before anything is computed; the second has those that
# failed once and take seconds; the third has all, in an hour and a half.
FIRST = [
    ("one constant", "inspect"),
    ("3 rows", "invert"),
    ("positions with a step back", "invert"),
    ("positions * 1e-5", "invert"),
    ("speed alternating", "invert"),
    ("one empty", "calibrate"),
]
SECOND = [
    ("a ramp", "invert with gaps"),
    ("positions with a spike", "fit a ridge"),
    ("positions + 1e9", "measure a kernel"),
]
CASES = [
    *FIRST,
    *(pytest.param(*case, marks=pytest.mark.full) for case in SECOND),
    *(pytest.param(*case, marks=pytest.mark.claim)
      for case in EVERY if case not in (*FIRST, *SECOND)),
]  # fmt: skip
# Hundreds of steps over a metre of cells, for a rig that such signals do not determine.
LONG_S = {
    ("positions with a spike", "calibrate"): 1200,
    ("speed over ten decades", "calibrate"): 600,
}


def check_end(code: int, said: str, folder: Path) -> None:
    """One line of refusal and nothing written, or a quality of every answer."""
    assert code in (0, 2), said
    assert "Traceback" not in said
    lines = [line for line in said.splitlines() if not line.endswith(" ...")]
    if code == 2:
        assert len(lines) == 1, said
        assert lines[0].startswith("srsinv: ")
        assert not folder.exists()
    else:
        assert lines == []
        assert json.loads((folder / "metrics.json").read_text())


def run(arguments, folder, capsys, most_s=MOST_S):
    began_s = time.monotonic()
    code = main([*arguments, f"hydra.run.dir={folder}"])
    check_end(code, capsys.readouterr().err, folder)
    assert time.monotonic() - began_s < most_s


@pytest.mark.parametrize(("file", "command"), CASES)
def test_odd_columns(file, command, tmp_path, capsys):
    path = odd_columns.write(file, tmp_path)
    most_s = LONG_S.get((file, command), MOST_S)
    run([*COMMANDS[command], f"recording.path={path}"], tmp_path / "out", capsys, most_s)


@pytest.mark.claim
@needs_shared
@pytest.mark.parametrize("command", ["inspect", "invert", "fit a ridge"])
@pytest.mark.parametrize("file", sorted(each.name for each in LAB_FILES.glob("*.[!ym]*")))
def test_lab_files(file, command, tmp_path, capsys):
    for each in LAB_FILES.glob(f"{Path(file).stem}.*"):
        shutil.copy(each, tmp_path)
    path = tmp_path / file
    run([*COMMANDS[command], f"recording.path={path}"], tmp_path / "out", capsys)


SURROUNDINGS = yaml.safe_load(
    (Path(__file__).parent / "surroundings.yaml").read_text(encoding="utf-8")
)


def tier(name):
    """A case with the mark of the first tier that has it."""
    of = SURROUNDINGS[name].get("tier", "full")
    return pytest.param(name, marks=() if of == "quick" else getattr(pytest.mark, of))


@pytest.mark.parametrize("name", [tier(name) for name in SURROUNDINGS])
def test_surroundings(name, tmp_path):
    case = SURROUNDINGS[name]
    path = odd_columns.write("as it is", tmp_path)
    (tmp_path / "broken").write_bytes(b"\xff\xfebackend: (nope\n")
    (tmp_path / "here").mkdir()
    program = f"{sys.executable} -m srsinv"
    line = case["type"].replace("srsinv", program).format(recording=f"recording.path={path}")
    unset = case.get("unset", [])
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment |= {name: str(value) for name, value in case.get("set", {}).items()}
    environment = {
        name: value.replace("{here}", str(tmp_path)) for name, value in environment.items()
    }
    done = subprocess.run(
        ["bash", "-c", line], env=environment, cwd=tmp_path / "here", capture_output=True,
        timeout=MOST_S, check=False,
    )  # fmt: skip
    said, shown = done.stderr.decode("latin-1"), done.stdout.decode("latin-1")
    assert not {"\x1b", "\a"} & {*said, *shown}
    assert done.returncode == case.get("code", 0), said
    assert "Traceback" not in said
    assert re.search(case.get("says", ""), said), said
    assert len(said.splitlines()) == bool(case.get("code", 0)) * case.get("lines", 1), said


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-16"])
def test_any_character_is_printed_in_any_encoding(encoding, tmp_path, monkeypatch):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(io.BytesIO(), encoding))
    assert main(["--help"]) == 0
    assert main(["µ–€=1"]) == 2
    sys.stderr.flush()
    assert "srsinv" in sys.stderr.buffer.getvalue().decode(encoding)
