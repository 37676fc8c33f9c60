"""What a configuration may name: classes of a kind and jobs, under the names that they were defined
with, and nothing else, wherever it stands."""

import re
import sys
from pathlib import Path

import pytest
import yaml

from srsinv.__main__ import find_config_root
from srsinv.errors import BadInput
from srsinv.forward.skin import HalfSpace
from srsinv.inverse.wiener import Exponential, Wiener
from srsinv.namespaces import import_experiments, load_job
from srsinv.targets import KINDS, check, make

SPECTRUM = {"_target_": "srsinv.inverse.wiener.Exponential", "rms_Pa": 1e3, "correlation_m": 2e-3}
WIENER = {"_target_": "srsinv.inverse.wiener.Wiener", "p": SPECTRUM, "q": SPECTRUM}
SCENE = {"_target_": "srsinv.forward.scene.TractionScene"}
SKIN = {"_target_": "srsinv.forward.skin.HalfSpace", "poisson_ratio": 0.5}
CANARY = "open({path!r}, 'w')"


def called(path, target="builtins.eval"):
    """A node that would write to `path` if it was made."""
    return {"_target_": target, "_args_": [CANARY.format(path=str(path))]}


def test_a_node_and_the_nodes_inside_are_made():
    made = make(WIENER, "method.wiener", "method")
    assert isinstance(made, Wiener)
    assert isinstance(made.p, Exponential)
    assert isinstance(make(SKIN, "skin", "skin"), HalfSpace)


# (kind, a node from the canary's path, words of the refusal)
HOSTILE = {
    "not a class": ("skin", lambda p: called(p), "not a class of srsinv"),
    "a module's": ("skin", lambda p: called(p, "os.system"), "not a class of srsinv"),
    "a part's argument": (
        "skin",
        lambda p: SKIN | {"poisson_ratio": called(p)},
        "not allowed there",
    ),
    "inside a part": ("method", lambda p: WIENER | {"p": called(p)}, "method.p._target_ is 'built"),
    "inside a part's part": (
        "method",
        lambda p: WIENER | {"p": SPECTRUM | {"rms_Pa": called(p)}},
        "method.p.rms_Pa has the key '_target_'",
    ),
    "in a list": ("scene", lambda p: SCENE | {"pressures": [called(p)]}, r"pressures[0]._target_"),
    "in a list in a list": ("scene", lambda p: SCENE | {"pressures": [[called(p)]]}, "[0][0]"),
    "in a mapping": ("scene", lambda p: SCENE | {"frictions": {"a": called(p)}}, "frictions.a."),
    "in a list of numbers": (
        "traction_feature",
        lambda p: {
            "_target_": "srsinv.forward.feature.LineFeature",
            "position_range_m": [0.0, called(p)],
        },
        "position_range_m[1] has the key '_target_'",
    ),
    "arguments": ("skin", lambda p: SKIN | {"_args_": [1]}, "no key '_args_'"),
    "partial": ("skin", lambda p: SKIN | {"_partial_": True}, "no key '_partial_'"),
    "recursive": ("skin", lambda p: SKIN | {"_recursive_": False}, "no key '_recursive_'"),
    "convert": ("skin", lambda p: SKIN | {"_convert_": "all"}, "no key '_convert_'"),
    "partial, where any key is taken": (
        "traction_feature",
        lambda p: {"_target_": "srsinv.forward.feature.LineFeature", "_partial_": True},
        "no key '_partial_'",
    ),
    "an imported name": (
        "skin",
        lambda p: called(p, "srsinv.recording._sidecar.Path"),
        "not a class",
    ),
    "a module's attribute": (
        "skin",
        lambda p: called(p, "srsinv.progress.sys.exit"),
        "not a class",
    ),
    "a function": ("skin", lambda p: called(p, "srsinv.errors.refuse"), "not a class"),
    "a method": ("skin", lambda p: called(p, "srsinv.grid.Line.operator"), "not a class"),
    "another kind": ("skin", lambda p: called(p, "srsinv.grid.Periodic"), "subclass of srs"),
    "another module's name for it": (
        "skin",
        lambda p: called(p, "srsinv.forward.sensor.HalfSpace"),
        "not a class",
    ),
    "a relative name": ("skin", lambda p: called(p, ".skin.HalfSpace"), "not a class"),
    "an empty part": ("skin", lambda p: called(p, "srsinv..forward.skin.HalfSpace"), "not a class"),
    "not text": ("skin", lambda p: {"_target_": ["srsinv"]}, "not a class"),
    "not there": ("skin", lambda p: {}, "skin._target_ is null"),
    "no mapping": ("skin", lambda p: "srsinv.forward.skin.HalfSpace", "a mapping of its keys"),
    "a tower": ("scene", lambda p: SCENE | {"pressures": tower(2000)}, "more than 20 levels"),
}


def tower(height):
    node: object = 1.0
    for _ in range(height):
        node = [node]
    return node


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_nodes_are_refused_and_not_called(tmp_path, case):
    kind, node, words = HOSTILE[case]
    canary = tmp_path / "canary"
    with pytest.raises(BadInput, match=re.escape(words)):
        make(node(canary), kind, kind)
    assert not canary.exists()


@pytest.mark.parametrize("name", ["this.s", "antigravity.fly", "tests.canary.Skin", "canary.Skin"])
def test_nothing_is_imported_to_look_at_a_name(tmp_path, monkeypatch, name):
    (tmp_path / "canary.py").write_text("from srsinv.forward.skin import HalfSpace as Skin\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = set(sys.modules)
    with pytest.raises(BadInput, match="not a class of srsinv"):
        make({"_target_": name}, "skin", "skin")
    assert {name.partition(".")[0]} & (set(sys.modules) - before) == set()


GROUPS = {
    "amplifier": "amplifier", "effects": "effects", "feature": "feature", "method": "method",
    "noise": "noise", "prior": "constraint", "rule": "rule", "scan": "scan", "skin": "skin",
    "solver": "solver", "surface": "surface",
}  # fmt: skip


@pytest.mark.parametrize("group", GROUPS)
def test_every_configured_part_is_of_its_kind(group):
    checked = 0
    for path in (find_config_root() / group).glob("*.yaml"):
        # What is looked up elsewhere is checked where it stands.
        own = [line for line in path.read_text().splitlines() if "${" not in line]
        text = "\n".join(own)
        if "_target_" in text and path.stem != "profile":
            check(yaml.safe_load(text), path.stem, GROUPS[group])
            checked += 1
    assert checked


def test_every_kind_has_a_base():
    for kind in KINDS:
        with pytest.raises(BadInput, match="is null, which is not a class"):
            check({}, "part", kind)


JOBS = {
    "srsinv.jobs.simulate.run": True,
    "experiments.shown.run": True,
    "experiments.shown.Skin": False,  # a class
    "experiments.shown.system": False,  # defined elsewhere
    "experiments.shown.absent": False,
    "experiments.elsewhere.run": False,
    "experiments": False,
    "srsinv.jobs.simulate": False,
    "srsinv.jobs.analysis.deviation": False,  # a function that is no job
    "srsinv.errors.refuse": False,
    "os.system": False,
    "builtins.exec": False,
    "": False,
    "experiments..run": False,
}


@pytest.fixture
def other_experiments():
    """Experiments of other folders may be imported; the clone's own are afterwards."""
    yield
    import_experiments(find_config_root())


@pytest.mark.usefixtures("other_experiments")
@pytest.mark.parametrize("name", [*JOBS, 3, None, ["a"], {"_target_": "os.system"}], ids=str)
def test_a_job_is_a_function_of_the_jobs_or_the_experiments(tmp_path, name):
    (tmp_path / "experiments").mkdir()
    (tmp_path / "configs").mkdir()
    (tmp_path / "experiments" / "shown.py").write_text(
        "from os import system\nclass Skin: pass\ndef run(cfg): return 'shown'\n"
    )
    (tmp_path / "elsewhere.py").write_text("def run(cfg): pass\n")
    if isinstance(name, str) and JOBS[name]:
        job = load_job(name, tmp_path / "configs")
        assert f"{job.__module__}.{job.__qualname__}" == name
    else:
        with pytest.raises(BadInput, match="which is not the function run of"):
            load_job(name, tmp_path / "configs")


@pytest.mark.usefixtures("other_experiments")
def test_experiments_are_those_beside_the_configurations(tmp_path, monkeypatch):
    """And nothing else beside them is importable: a clone's other folders are no packages."""
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    before = list(sys.path)
    for name in ("first", "second"):
        folder = tmp_path / name / "experiments"
        folder.mkdir(parents=True)
        Path(folder, "shown.py").write_text(f"def run(cfg): return {name!r}\n")
        job = load_job("experiments.shown.run", tmp_path / name / "configs")
        assert job({}) == name
    assert sys.path == before
