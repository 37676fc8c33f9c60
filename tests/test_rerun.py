"""`srsinv rerun=FOLDER`: the same run again from what its folder records, and nothing more."""

import json
from pathlib import Path

import pytest

from srsinv.__main__ import main
from srsinv.run_folder import MANIFEST, RunRecord, listing, manifest
from tests.stability import killed
from tests.tiers import quick

TOUCH = "import pathlib\n\npathlib.Path('canary').touch()\n"


@pytest.fixture
def root(tmp_path, monkeypatch):
    """The configuration of a quick job; the current folder is an empty one."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return killed.make_root(tmp_path / "clone")


@pytest.fixture
def first(root):
    assert main(["value=3.0", "seed=5", "hydra.run.dir=first"], root) == 0
    return Path("first")


def record(folder):
    return json.loads(Path(folder, MANIFEST).read_text())


def forged(command, folder="foreign"):
    """The folder of a run of somebody else, which records this command."""
    Path(folder).mkdir()
    Path(folder, "metrics.json").write_bytes(b"{}\n")
    files = listing({"metrics.json": b"{}\n"})
    Path(folder, MANIFEST).write_bytes(manifest(files, RunRecord(command, 0)))
    return folder


@pytest.mark.parametrize("given", ["first", "first/", "first/run.json"])
def test_a_run_is_repeated_in_a_new_folder(given, root, first, capsys):
    before = {path: path.read_bytes() for path in first.rglob("*") if path.is_file()}
    capsys.readouterr()
    assert main([f"rerun={given}"], root) == 0
    printed = capsys.readouterr()
    again = Path(printed.out.splitlines()[-1])
    assert again != first.absolute()
    assert printed.err.splitlines() == ["srsinv: repeating srsinv value=3.0 seed=5"]
    for name in ("metrics.json", "result.nc", ".hydra/config.yaml", ".hydra/overrides.yaml"):
        assert (again / name).read_bytes() == (first / name).read_bytes()
    old, new = record(first), record(again)
    assert {key: old[key] for key in ("command", "seed", "configuration", "versions")} == {
        key: new[key] for key in ("command", "seed", "configuration", "versions")
    }
    assert before == {path: path.read_bytes() for path in first.rglob("*") if path.is_file()}


def test_its_place_may_be_given(root, first):
    assert main(["rerun=first", "hydra.run.dir=second"], root) == 0
    assert Path("second/metrics.json").read_bytes() == (first / "metrics.json").read_bytes()


def test_a_sweep_is_repeated(root):
    assert main(["-m", "value=1.0,2.0", "hydra.sweep.dir=sweep"], root) == 0
    assert main(["rerun=sweep", "hydra.sweep.dir=again"], root) == 0
    for name in ("0/metrics.json", "1/metrics.json"):
        assert Path("again", name).read_bytes() == Path("sweep", name).read_bytes()
    assert main(["rerun=sweep/1", "hydra.run.dir=one"], root) == 0
    assert Path("one/metrics.json").read_bytes() == Path("sweep/1/metrics.json").read_bytes()


def test_a_default_that_has_changed_is_reported(root, first, capsys):
    config = root / "config.yaml"
    config.write_text(f"{config.read_text()}another: 1\n")
    assert main(["rerun=first", "hydra.run.dir=second"], root) == 0
    assert "has changed since" in capsys.readouterr().err


BESIDE = {
    "a setting": (["seed=6"], "'seed=6' would change it"),
    "a sweep": (["-m"], "'-m' would change it"),
    "a second run": (["rerun=first"], "would change it"),
    "its own folder": (["hydra.run.dir=first"], "is the folder of the run that is repeated"),
    "options": (["--config-dir", "."], "made without --config-dir"),
}


@pytest.mark.parametrize("case", BESIDE)
def test_nothing_else_stands_beside(case, root, first, capsys):
    given, sentence = BESIDE[case]
    assert main(["rerun=first", *given], root) == 2
    assert sentence in capsys.readouterr().err
    assert not Path("outputs").exists()


def test_a_folder_without_a_run_is_refused(root, first, capsys):
    Path("empty").mkdir()
    (first / MANIFEST).write_text("{}")
    for folder in ("absent", "empty", "first", "a\0b", ""):
        assert main([f"rerun={folder}"], root) == 2
        assert "holds no run.json" in (said := capsys.readouterr().err) or "rerun is" in said
    assert not Path("outputs").exists()


FOREIGN = {
    "another program": "sh -c 'touch canary'",
    "a command that is none": "srsinv 'value=1",
    "no text": 3,
    "a flag": "srsinv --cfg job",
    "a flag behind": "srsinv value=1 --config-dir plugins",
    "a setting of Hydra": "srsinv hydra.run.dir=elsewhere",
    "a launcher": "srsinv hydra/launcher=parallel",
    "a callback": "srsinv +hydra.callbacks.it._target_=plugins.evil.Evil",
    "itself": "srsinv rerun=foreign",
    "a class": "srsinv job=plugins.evil.run",
    "a function": "srsinv job=os.system",
    "no key": "srsinv absent=1",
}


@pytest.mark.parametrize("case", quick(FOREIGN, *[*FOREIGN][::2]))
def test_a_foreign_folder_runs_no_code(case, root, capsys):
    """What it records is refused, or fails as the same command does where it is typed."""
    folder = forged(FOREIGN[case])
    Path(folder, "plugins").mkdir()
    Path(folder, "plugins/evil.py").write_text(TOUCH)
    assert main([f"rerun={folder}"], root) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("srsinv: ")
    assert {path.name for path in Path(".").iterdir()} == {"foreign"}


def test_plugins_are_those_of_a_folder_that_is_typed(root, tmp_path, capsys):
    own = tmp_path / "own"
    (own / "plugins").mkdir(parents=True)
    (own / "plugins/evil.py").write_text(TOUCH)
    folder = forged(f"srsinv --config-dir {own} job=plugins.evil.run")
    assert main([f"rerun={folder}"], root) == 2
    said = capsys.readouterr().err
    assert f"type srsinv --config-dir {own} rerun=" in said
    assert not Path("canary").exists()
    assert main(["--config-dir", str(own), f"rerun={folder}"], root) == 2  # it has no run
    assert Path("canary").exists()


@pytest.mark.full
def test_a_simulation_repeats_to_the_last_bit(tmp_path):
    small = ("grid.cells=64", "grid.refinement=2", "method=[tikhonov]", "seed=3", "figures=none")
    assert main([*small, f"hydra.run.dir={tmp_path}/first"]) == 0
    assert main([f"rerun={tmp_path}/first", f"hydra.run.dir={tmp_path}/second"]) == 0
    first, second = (
        json.loads((tmp_path / name / "metrics.json").read_text()) for name in ("first", "second")
    )
    assert {k for k in first if first[k] != second[k]} <= {
        "first_call_s_tikhonov", "steady_call_s_tikhonov",
    }  # fmt: skip
    assert first.keys() == second.keys()
