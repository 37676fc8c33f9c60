"""What a run may write over: earlier runs of srsinv, and nothing else."""

import contextlib
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pytest

from srsinv import __version__
from srsinv.__main__ import find_config_root, main
from srsinv.errors import BadInput
from srsinv.run_folder import MANIFEST, RunRecord, check, claim, commit_of
from tests.stability import killed
from tests.tiers import quick

REPOSITORY = Path(__file__).parents[1]


@pytest.fixture
def root(tmp_path, monkeypatch):
    """The configuration of a quick job; the current folder is an empty one."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return killed.make_root(tmp_path / "clone")


def snapshot(folder):
    """All that is in a folder, with what each file says and each link leads to."""
    return {
        str(path.relative_to(folder)): (
            os.readlink(path) if path.is_symlink()
            else path.read_bytes() if path.is_file()
            else path.lstat().st_mode
        )
        for path in Path(folder).rglob("*")
    }  # fmt: skip


def sentence(capsys):
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    assert line.startswith("srsinv: ")
    return line


def write(name, text="mine"):
    def make(folder):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)

    return make


def append(name):
    def make(folder):
        with (folder / name).open("a") as file:
            file.write("mine")

    return make


def link(name, target):
    def make(folder):
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(target)

    return make


def aside(folder):
    """A listed file, with the same bytes, at the end of a link."""
    (folder / "metrics.json").rename(folder.parent / "metrics.json")
    (folder / "metrics.json").symlink_to(folder.parent / "metrics.json")


def rewritten(**changes):
    def make(folder):
        manifest = json.loads((folder / MANIFEST).read_text())
        text = json.dumps(manifest | changes, sort_keys=True, indent=2)
        (folder / MANIFEST).write_text(f"{text}\n")

    return make


def both(*makers):
    def make(folder):
        for maker in makers:
            maker(folder)

    return make


# (what is in the folder of an earlier run, the name in the refusal)
FOREIGN = {
    "file": (write("data.csv"), "data.csv"),
    "hidden file": (write(".secret"), ".secret"),
    "file among figures": (write("figures/mine.png"), "figures/mine.png"),
    "file in a folder": (write("mine/deep/data.csv"), "mine/"),
    "empty folder": (lambda folder: (folder / "mine").mkdir(), "mine/"),
    "empty folder among figures": (lambda folder: (folder / "figures/a").mkdir(), "figures/a/"),
    "link": (link("latest", "metrics.json"), "latest"),
    "link that leads nowhere": (link("latest", "nowhere"), "latest"),
    "link to a folder": (link("all", ".."), "all"),
    "link in a file's place": (aside, "metrics.json"),
    "pipe": (lambda folder: os.mkfifo(folder / "pipe"), "pipe"),
    "folder of a workspace's name": (write(".srsinv/mine"), ".srsinv/"),
    "page that was changed": (append("report.html"), "report.html"),
    "sidecar that was filled in": (append("notes.yaml"), "notes.yaml"),
    "manifest that was changed": (append("run.json"), "run.json"),
    "manifest with a note": (rewritten(note="mine"), "run.json"),
    "manifest of another program": (write("run.json", '{"files": {}}'), "run.json"),
    "manifest that leads out": (rewritten(files={"../mine": "0" * 64}), "run.json"),
    "manifest of a deep nest": (write("run.json", "[" * 100_000), "run.json"),
    "manifest that leads far down": (rewritten(files={"a/" * 99 + "b": "0" * 64}), "run.json"),
    "manifest of a name that no file has": (rewritten(files={"\ud800": "0" * 64}), "run.json"),
    "no manifest": (lambda folder: (folder / "run.json").unlink(), ".hydra/"),
    "only numbers": (
        lambda folder: [shutil.rmtree(folder), write("metrics.json")(folder)], "metrics.json",
    ),
}  # fmt: skip


class TestForeignFiles:
    @pytest.mark.parametrize(
        ("make", "name"), quick(FOREIGN.values(), *[*FOREIGN.values()][::3]), ids=FOREIGN
    )
    def test_they_stay(self, root, tmp_path, monkeypatch, capsys, make, name):
        """One sentence names the file; all is as it was. So it is from within the folder."""
        folder = tmp_path / "run"
        killed.page(folder, 1.0)
        make(folder)
        before = snapshot(tmp_path)
        assert main([f"hydra.run.dir={folder}"], root) == 2
        assert name in sentence(capsys)
        monkeypatch.chdir(folder)
        with pytest.raises(BadInput, match=re.escape(name)):
            check(Path("."))
        assert snapshot(tmp_path) == before

    def test_nothing_heavy_is_imported_before(self, root, tmp_path, monkeypatch, capsys):
        monkeypatch.setattr("srsinv.command.launch.load_job", None)  # would fail
        write("mine")(Path("."))
        assert main(["hydra.run.dir=."], root) == 2
        assert "mine" in sentence(capsys)

    def test_what_comes_in_while_the_job_runs(self, tmp_path):
        folder = tmp_path / "run"
        killed.page(folder, 1.0)
        with claim(folder) as workspace:
            write("late.txt")(folder)
            before = snapshot(folder)
            with pytest.raises(BadInput, match=r"late\.txt"):
                workspace.replace({"metrics.json": b"2"}, RunRecord("srsinv", 0))
        assert snapshot(folder) == before
        assert os.listdir(tmp_path) == ["run"]

    def test_a_folder_that_goes_while_the_job_runs(self, tmp_path):
        with claim(tmp_path / "run") as workspace:
            (tmp_path / "run").rmdir()
            workspace.replace({"metrics.json": b"2"}, RunRecord("srsinv", 0))
        assert (tmp_path / "run" / "metrics.json").read_bytes() == b"2"

    def test_a_sidecar_that_was_filled_in(self, tmp_path, monkeypatch, capsys):
        """Beside the recording, as the page tells to, and in the folder of the inspection."""
        write("scan.csv", "time_s,voltage_0_V\n")(tmp_path)
        write("scan.yaml", "polarity: -1\n")(tmp_path)
        monkeypatch.chdir(tmp_path)
        before = snapshot(tmp_path)
        arguments = ["experiment=inspect_recording", "recording.path=scan.csv"]
        assert main([*arguments, "hydra.run.dir=."], find_config_root()) == 2
        assert "scan.csv" in sentence(capsys)
        assert snapshot(tmp_path) == before


# What a folder of somebody else can hold: makers in the folder `here`, beside which the user's are.
def old_workspace(here):
    """What a version of srsinv took for its own, and followed the links in it."""
    inside = here / "outputs/.run.srsinv/new"
    killed.page(inside, 1.0)
    shutil.move(inside / "report.html", inside / "notes.txt")
    (here / "outputs/run").mkdir()
    (here / "outputs/run/.srsinv").symlink_to("../../../mine")
    (here / "outputs/run/figures").symlink_to("../../../mine")


def remains(here):
    """A folder as a killed run leaves one, with links in it."""
    killed.page(here / "outputs/.srsinv-0123456789abcdef", 1.0)
    link("outputs/.srsinv-0123456789abcdef/figures/signal.png", "../../../mine/notes")(here)


def in_a_run(name, target):
    """An earlier run in which `name` leads to the user's."""

    def make(here):
        killed.page(here / "outputs/run", 1.0)
        path = here / "outputs/run" / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        path.symlink_to(target)

    return make


def linked_folder(target):
    """Links to the user's where a run is to go."""

    def make(here):
        (here / "outputs").mkdir()
        (here / "outputs/run").symlink_to(target)

    return make


def hard_linked(here):
    """An earlier run of which one file is the user's own, too."""
    killed.page(here / "outputs/run", 1.0)
    (here / "outputs/run/metrics.json").unlink()
    os.link(here.parent / "mine/run/metrics.json", here / "outputs/run/metrics.json")


def pipes(here):
    killed.page(here / "outputs/run", 1.0)
    for name in ("metrics.json", "run.json", "report.html"):
        (here / "outputs/run" / name).unlink()
        os.mkfifo(here / "outputs/run" / name)


def huge(here):
    """A listed file of terabytes, of which nothing is stored."""
    killed.page(here / "outputs/run", 1.0)
    with (here / "outputs/run/result.nc").open("r+b") as file:
        file.truncate(2**42)


def linked_sweep(here):
    """A sweep whose first job's folder is one of the user's."""
    assert main(["-m", "hydra.sweep.dir=outputs/run", "value=1,2"], find_root(here)) == 0
    shutil.rmtree(here / "outputs/run/0")
    (here / "outputs/run/0").symlink_to("../../../mine/run")


def find_root(here):
    return here.parent / "clone/configs"


HOSTILE = {
    "workspace of an older version": old_workspace,
    "remains of a killed run": remains,
    "folder that is a link": linked_folder("../../mine"),
    "folder that is a link to a run": linked_folder("../../mine/run"),
    "folder above that is a link": link("outputs", "../mine"),
    "manifest that is a link": in_a_run("run.json", "../../../mine/run/run.json"),
    "file that is a link": in_a_run("metrics.json", "../../../mine/run/metrics.json"),
    "figures that are a link": in_a_run("figures", "../../../mine"),
    "configuration that is a link": in_a_run(".hydra", "../../../mine/run/.hydra"),
    "hard link": hard_linked,
    "pipes": pipes,
    "huge file": huge,
    "sweep with a link": linked_sweep,
}
FEW_HOSTILE = ("workspace of an older version", "figures that are a link")
COMMANDS = (
    ["hydra.run.dir=outputs/run"], ["hydra.run.dir=outputs/new"], ["hydra.run.dir=."],
    ["-m", "hydra.sweep.dir=outputs/run", "value=3,4"],
    ["-m", "hydra.sweep.dir=outputs", "hydra.sweep.subdir=run", "value=3"], [],
)  # fmt: skip


class TestFoldersOfOthers:
    @pytest.mark.parametrize("case", quick(HOSTILE, *FEW_HOSTILE))
    def test_nothing_of_the_users_changes(self, root, tmp_path, capsys, case):
        """Whatever they hold, and whichever command is run in them; a new folder may be made
        through a link."""
        mine, here = tmp_path / "mine", tmp_path / "here"
        killed.page(mine / "run", 7.0)
        write("notes")(mine)
        (mine / "empty").mkdir()
        HOSTILE[case](here)
        before = snapshot(mine)
        for arguments in COMMANDS:
            assert main(arguments, root) in (0, 2)
            assert snapshot(mine).items() >= before.items()
        assert "Traceback" not in capsys.readouterr().err

    @pytest.mark.parametrize(
        "names", quick(["run", "run/figures", "run/metrics.json", "here"], "run/figures")
    )
    def test_a_link_that_comes_between(self, tmp_path, monkeypatch, names):
        """In the place of the folder, of one in it, of a file and of one above, before every change
        that a run makes on the disk: it ends well or is refused."""
        for at in itertools.count():
            shutil.rmtree(tmp_path)
            mine, here = tmp_path / "mine", tmp_path / "here"
            killed.page(mine / "run", 7.0)
            killed.page(here / "run", 1.0)
            write("figures/notes")(mine)
            before = snapshot(mine)
            place = tmp_path / names if names == "here" else here / names

            def come_between(place=place, mine=mine):
                with contextlib.suppress(OSError):
                    os.rename(place, place.with_name("aside"))
                    is_file = place.name.endswith(".json")
                    place.symlink_to(mine / "run/metrics.json" if is_file else mine / "run")

            with monkeypatch.context() as patches:
                done = killed.interrupted(come_between, at, killed.CHANGES["exit"], patches.setattr)
                with contextlib.suppress(BadInput):
                    killed.page(here / "run", 2.0)
            assert snapshot(mine) == before
            if len(done) <= at:
                return


class TestEarlierRuns:
    @pytest.mark.parametrize("exchanges", quick([True, False], True))
    @pytest.mark.parametrize(
        "place", quick(["by name", "current", "around the current"], "by name")
    )
    def test_are_replaced_as_a_whole(self, root, tmp_path, monkeypatch, place, exchanges):
        """Also where the file system cannot exchange two names."""
        if not exchanges:
            monkeypatch.setattr("srsinv.atomic._renameat2", lambda *_: False)
        folder = tmp_path / "run"
        killed.page(folder, 1.0)
        with claim(folder) as workspace:
            files = {**dict.fromkeys(killed.PAGE, b"x"), "figures/other.png": b"y"}
            workspace.replace(files, RunRecord("srsinv", 1))
        if place in ("current", "around the current"):
            monkeypatch.chdir(folder if place == "current" else folder / "figures")
        names = {"by name": folder, "current": "."}
        assert main([f"hydra.run.dir={names.get(place, '..')}", "value=5"], root) == 0
        assert json.loads((folder / "metrics.json").read_text()) == {"value": 5}
        assert {name for name in snapshot(folder) if "." in name[1:]} == {
            MANIFEST, "metrics.json", "result.nc", "report.html", "notes.yaml",
            "figures/signal.png", ".hydra/config.yaml", ".hydra/hydra.yaml",
            ".hydra/overrides.yaml",
        }  # fmt: skip
        assert not list(tmp_path.glob("**/.srsinv-*"))

    def test_keep_their_mode(self, tmp_path):
        killed.page(tmp_path / "run", 1.0)
        (tmp_path / "run").chmod(0o2770)
        killed.page(tmp_path / "run", 2.0)
        assert (tmp_path / "run").stat().st_mode & 0o7777 == 0o2770

    def test_a_file_that_is_missing_is_no_hindrance(self, tmp_path):
        killed.page(tmp_path / "run", 1.0)
        (tmp_path / "run" / "result.nc").unlink()
        check(tmp_path / "run")
        killed.page(tmp_path / "run", 2.0)
        assert (tmp_path / "run" / "result.nc").is_file()


class TestManifest:
    def test_says_what_was_run(self, root, tmp_path):
        (tmp_path / "mine").mkdir()
        arguments = ["--config-dir", "../mine", "hydra.run.dir=a", "seed=3", "value=2.5"]
        assert main(arguments, root) == 0
        manifest = json.loads(Path("a", MANIFEST).read_text())
        assert manifest["version"] == __version__
        assert manifest["command"] == "srsinv --config-dir ../mine seed=3 value=2.5"
        assert manifest["command"] in Path("a", "report.html").read_text()
        assert manifest["seed"] == 3
        assert {*manifest["files"], MANIFEST} == {
            name for name in snapshot("a") if Path("a", name).is_file()
        }

    def test_same_run_same_manifest(self, root, tmp_path, monkeypatch):
        """Elsewhere, too, and in folders named after the time; its date aside."""
        assert main(["hydra.run.dir=a"], root) == 0
        assert main([], root) == 0
        (tmp_path / "there").mkdir()
        monkeypatch.chdir(tmp_path / "there")
        assert main([], root) == 0
        made = [json.loads(path.read_bytes()) | {"date": ""} for path in tmp_path.rglob(MANIFEST)]
        assert made == [made[0]] * 3


# (folder as typed, what is there)
PLACES = {
    "a long name": ("a" * 300, None),
    "a long name further down": (f"new/{'a' * 300}/b", None),
    "a long path": ("/".join(["a" * 100] * 50), None),
    "a character that no name has": ("a\0b", None),
    "half a character": ("a\udc80", None),
    "another half": ("a\ud800", None),
    "a link to itself": ("loop", lambda: Path("loop").symlink_to("loop")),
    "below it": ("loop/run", lambda: Path("loop").symlink_to("loop")),
    "a link that leads nowhere": ("link", lambda: Path("link").symlink_to("no")),
    "a file": ("file", lambda: Path("file").touch()),
    "a pipe": ("pipe", lambda: os.mkfifo("pipe")),
    "a folder in a file": ("file/run", lambda: Path("file").touch()),
    "the folder above": ("..", None),
    "the root": ("/", None),
    "a system folder": ("/proc", None),
}  # fmt: skip


class TestOutput:
    @pytest.mark.full
    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
    def test_that_cannot_be_printed(self, root, tmp_path):
        """The run is there all the same."""
        program = "import sys; from srsinv.__main__ import *; sys.exit(main(sys.argv[2:], "
        program += "Path(sys.argv[1])))"
        with open("/dev/full", "w") as full:
            done = subprocess.run(
                [sys.executable, "-c", program, root, "hydra.run.dir=a"],
                stdout=full, stderr=subprocess.PIPE, text=True,
                env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
            )  # fmt: skip
        assert done.returncode == 2
        (line,) = done.stderr.splitlines()
        assert line.startswith("srsinv: cannot print what was found (No space left")
        check(Path("a"))
        assert Path("a", MANIFEST).is_file()


POSSIBLE = ["", ".", "new/deep/run", "a b", "é", "a/../b", "n" * 255]


class TestPlaces:
    @pytest.mark.parametrize("flags", quick([[], ["-m"]], []))
    @pytest.mark.parametrize(
        ("typed", "make"), quick(PLACES.values(), *[*PLACES.values()][::3]), ids=PLACES
    )
    def test_that_no_run_can_have(self, root, tmp_path, capsys, typed, make, flags):
        if make:
            make()
        before = snapshot(tmp_path)
        key = "sweep" if flags else "run"
        assert main([*flags, f'hydra.{key}.dir="{typed}"'], root) == 2
        assert len(sentence(capsys)) < 600
        assert snapshot(tmp_path) == before

    @pytest.mark.parametrize("typed", quick(POSSIBLE, "new/deep/run", "é"))
    def test_that_a_run_can_have(self, root, tmp_path, typed):
        folder = Path(os.path.realpath(typed))
        assert main([f'hydra.run.dir="{typed}"'], root) == 0
        assert (folder / MANIFEST).is_file()
        assert main([f'hydra.run.dir="{typed}"', "value=3"], root) == 0
        assert json.loads((folder / "metrics.json").read_text()) == {"value": 3}
        assert not list(tmp_path.glob("**/.srsinv-*"))

    @pytest.mark.parametrize("override", ["hydra.output_subdir=mine", "hydra/job_logging=default"])
    def test_hydra_writes_nothing_of_its_own(self, root, tmp_path, capsys, override):
        before = snapshot(tmp_path)
        assert main([override], root) == 2
        assert "hydra" in sentence(capsys)
        assert snapshot(tmp_path) == before


def sweep(root, *arguments):
    return main(["-m", "hydra.sweep.dir=sweep", *arguments], root)


def a_run(_):
    killed.page(Path("sweep"), 1.0)


@pytest.mark.full
class TestSweeps:
    def test_over_an_earlier_one(self, root, capsys):
        """Its record and the runs of the same numbers are replaced; another stays."""
        assert sweep(root, "value=1,2,3") == 0
        assert sweep(root, "value=4,5") == 0
        values = [json.loads(Path(f"sweep/{i}/metrics.json").read_text()) for i in range(3)]
        assert [each["value"] for each in values] == [4, 5, 3]
        assert "value=4,5" in Path("sweep/multirun.yaml").read_text()
        assert "-m value=4,5" in Path("sweep", MANIFEST).read_text()

    @pytest.mark.parametrize(
        ("make", "name"),
        [
            (write("sweep/multirun.yaml"), "multirun.yaml"),
            (write("sweep/multirun.yaml", "hydra:\n"), "multirun.yaml"),
            (write("sweep/data.csv"), "data.csv"),
            (a_run, MANIFEST),
            (lambda _: Path("sweep").mkdir() or Path("sweep/0").symlink_to(".."), "0"),
        ],
    )
    def test_not_over_anything_else(self, root, tmp_path, capsys, make, name):
        make(Path("."))
        before = snapshot(tmp_path)
        assert sweep(root, "value=1,2") == 2
        assert name in sentence(capsys)
        assert snapshot(tmp_path) == before

    @pytest.mark.parametrize("name", ["multirun.yaml", "run.json", "mine"])
    def test_not_over_one_that_was_changed(self, root, tmp_path, capsys, name):
        assert sweep(root, "value=1,2") == 0
        append(f"sweep/{name}")(Path("."))
        before = snapshot(tmp_path)
        capsys.readouterr()
        assert sweep(root, "value=3,4") == 2
        assert name in sentence(capsys)
        assert snapshot(tmp_path) == before

    def test_a_run_that_cannot_be_replaced_stays_and_the_others_go_on(self, root, capsys):
        assert sweep(root, "value=1,2,3") == 0
        write("sweep/1/data.csv")(Path("."))
        before = snapshot("sweep/1")
        assert sweep(root, "value=4,5,6") == 2
        assert "data.csv" in capsys.readouterr().err
        assert snapshot("sweep/1") == before
        values = [json.loads(Path(f"sweep/{i}/metrics.json").read_text()) for i in (0, 2)]
        assert [each["value"] for each in values] == [4, 6]

    @pytest.mark.parametrize("subdir", ["one", "."])
    def test_one_folder_for_all_is_refused(self, root, capsys, subdir):
        assert sweep(root, "value=1,2", f"hydra.sweep.subdir={subdir}") == 2
        said = capsys.readouterr().err
        assert "hydra.sweep.subdir" in said

    def test_a_run_over_a_sweep_is_refused(self, root, tmp_path, capsys):
        assert sweep(root, "value=1,2") == 0
        before = snapshot(tmp_path)
        capsys.readouterr()
        assert main(["hydra.run.dir=sweep"], root) == 2
        assert "0/" in sentence(capsys)
        assert snapshot(tmp_path) == before


COMMIT = "0123456789abcdef" * 2 + "01234567"
# Files of a clone, and whether they tell its commit.
CLONES = {
    "a branch": (
        {".git/HEAD": "ref: refs/heads/a/b\n", ".git/refs/heads/a/b": f"{COMMIT}\n"},
        True,
    ),
    "no branch": ({".git/HEAD": f"{COMMIT}\n"}, True),
    "a packed branch": (
        {
            ".git/HEAD": "ref: refs/heads/main\n",
            ".git/packed-refs": f"# pack-refs\n{'f' * 40} refs/heads/other\n"
            f"{COMMIT} refs/heads/main\n",
        },
        True,
    ),
    "a further work tree": (
        {
            ".git": "gitdir: main/worktrees/it\n",
            "main/worktrees/it/HEAD": "ref: refs/heads/main\n",
            "main/worktrees/it/commondir": "../..\n",
            "main/refs/heads/main": COMMIT,
        },
        True,
    ),
    "no clone": ({}, False),
    "an unborn branch": ({".git/HEAD": "ref: refs/heads/main\n"}, False),
    "a path that leads out": ({".git/HEAD": "ref: refs/../../secret\n", "secret": COMMIT}, False),
    "no commit": ({".git/HEAD": "ref: refs/heads/main\n", ".git/refs/heads/main": "rm -r"}, False),
}


@pytest.mark.parametrize("clone", CLONES)
def test_the_commit_of_a_clone_is_read_from_its_files(clone, tmp_path):
    files, is_known = CLONES[clone]
    for name, text in {"pyproject.toml": 'name = "srsinv"\n', **files}.items():
        write(name, text)(tmp_path)
    assert commit_of(tmp_path) == (COMMIT if is_known else None)
    write("pyproject.toml", 'name = "other"\n')(tmp_path)
    assert commit_of(tmp_path) is None


def test_a_run_says_when_and_by_what_it_was_made(root, tmp_path):
    assert main([f"hydra.run.dir={tmp_path}/run"], root) == 0
    made = json.loads((tmp_path / "run" / MANIFEST).read_text())
    assert datetime.fromisoformat(made["date"]).tzinfo is not None
    assert made["versions"].keys() == {"srsinv", "python", "jax", "jaxlib", "numpy"}
    assert made["versions"]["srsinv"] == __version__
    assert made["commit"] == commit_of(REPOSITORY)
