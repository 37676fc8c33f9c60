"""A sidecar that asks for code to be run: the whole command refuses it, a canary stays as it was,
and the process does nothing that it was not asked for by its user."""

import copy
import json
import os
import random
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import xarray
import yaml

EXAMPLES = Path(__file__).parents[2] / "srsinv" / "examples"
ROOT = Path(__file__).parents[2]
FACTS = json.loads((EXAMPLES / "strip_two_element.json").read_text())
CANARY = "canary"
WRITE = f"open({CANARY!r}, 'w').close()"
QUICK = 2  # of each format, beside the literal ones; the slow test takes all, and so many drawn:
DRAWN = 60

# What a hostile part may look like.
NODES = (
    {"_target_": "builtins.eval", "_args_": [WRITE]},
    {"_target_": "builtins.float", "_args_": [{"_target_": "builtins.exec", "_args_": [WRITE]}]},
    {"_target_": "os.system", "command": f"rm {CANARY}"},
    {"_target_": "os.unlink", "path": CANARY},
    {"_target_": "subprocess.run", "args": ["rm", CANARY]},
    {"_target_": "hydra.utils.get_method", "path": "os.system"},
    {"_target_": "pathlib.Path.unlink", "self": CANARY},
    {"_target_": "srsinv.recording._sidecar.Path", "_args_": [CANARY]},
    {"_target_": "canary_module.Skin"},
    {"_target_": "srsinv.forward.skin.HalfSpace", "poisson_ratio": 0.5},
    {"_partial_": True, "_target_": "builtins.exec"},
    "${oc.env:HOME}",
    f"!!python/object/apply:os.system ['rm {CANARY}']",
)
PLACES = (
    ("skin",), ("skin", "poisson_ratio"), ("skin", "_target_"), ("sensor",), ("sensor", "depth_m"),
    ("sensor", "elements"), ("sensor", "elements", 0), ("sensor", "elements", 1, "offset_m"),
    ("sensor", "elements", 0, "orientation"), ("sensor", "piezo_constants_C_per_N", "d1"),
    ("sensor", "feedback_resistance_ohm"), ("gain",), ("polarity",), ("contact_window_m",),
    ("nominal_pressure_Pa",), ("feature",), ("feature", "edge_length_m"), ("speed_m_per_s",),
    ("sample_rate_hz",), ("channels",), ("signal_unit",), ("time_unit",), ("scan_start_m",),
    ("method",), ("noise",), ("effects",), ("job",), ("hydra",), ("_target_",), ("skin", "model"),
)  # fmt: skip
# Those of JSON and YAML alone that try to run something; further ones are rows of `bad`.
LITERAL = {
    "yaml": (
        f"skin: !!python/object/apply:os.system ['rm {CANARY}']\n",
        f"skin: {{poisson_ratio: !!python/object/new:subprocess.Popen [['rm', {CANARY}]]}}\n",
        "a: &a [x, x]\nb: &b [*a, *a]\ngain: [*b, *b]\n",
        "gain: !!float '2'\n",
        "? [gain]\n: 2\n",
        "gain: " + "[" * 5000,
    ),
    "json": ('{"description": "\\ud800"}',),
}


def placed(place, node):
    """The example's facts with a hostile part at a place."""
    facts = copy.deepcopy(FACTS)
    at = facts
    for key in place[:-1]:
        at = at[key] if isinstance(at, list) else at.setdefault(key, {})
    at[place[-1]] = node
    return facts


def hostile_texts(kind, is_quick):
    """Every place and every node at least once, or a few of them."""
    chosen = random.Random(kind)
    drawn = [placed(chosen.choice(PLACES), chosen.choice(NODES)) for _ in range(DRAWN)]
    each = [placed(place, NODES[i % len(NODES)]) for i, place in enumerate(PLACES)]
    if is_quick:
        drawn, each = [], chosen.sample(each, QUICK)
    write = yaml.safe_dump if kind == "yaml" else json.dumps
    return [*map(write, [*each, *drawn]), *LITERAL["yaml" if kind == "yaml" else "json"]]


def in_netcdf(path, text):
    columns = {"time_s": range(9), "speed_m_per_s": [0.1] * 9, "voltage_0_V": [0.0, 1.0, 2.0] * 3}
    variables = {name: ("sample", list(map(float, values))) for name, values in columns.items()}
    xarray.Dataset(variables, attrs={"sidecar": text}).to_netcdf(path, engine="h5netcdf")


@pytest.mark.full
@pytest.mark.parametrize("is_quick", [True, pytest.param(False, marks=pytest.mark.claim)])
def test_hostile_sidecars(tmp_path, is_quick):
    (tmp_path / CANARY).write_text("alive")
    (tmp_path / "canary_module.py").write_text(f"import os; os.unlink({CANARY!r})\n")
    texts = {
        f"{kind}{number:03}": text
        for kind in ("json", "netcdf", "yaml")
        for number, text in enumerate(hostile_texts(kind, is_quick))
    }
    for name, text in texts.items():
        if name.startswith("netcdf"):
            in_netcdf(tmp_path / f"{name}.nc", text)
        else:
            shutil.copy(EXAMPLES / "strip_two_element.csv", tmp_path / f"{name}.csv")
            (tmp_path / f"{name}.{name[:4]}").write_text(text)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    done = subprocess.run(
        [sys.executable, "-m", "tests.recording.hostile_sidecars", str(tmp_path)],
        cwd=ROOT, env=os.environ | {"JAX_PLATFORMS": "cpu"}, capture_output=True, text=True,
        check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    reports = json.loads(done.stdout)
    assert len(reports) == len(texts)
    for name, code, said, caused in reports:
        text = texts[name]
        assert (code, caused) == (2, []), (text, said)
        assert re.fullmatch(r"srsinv: .*\n", said), (text, said)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
