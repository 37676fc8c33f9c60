"""What a run may write over: earlier runs of srsinv, and nothing else."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from srsinv import __version__
from srsinv.__main__ import find_config_root, main
from srsinv.errors import BadInput
from srsinv.run_folder import GATHERED, MANIFEST, check, claim
from tests.stability import killed
from tests.tiers import quick

REPOSITORY = Path(__file__).parents[1]
REMEDY = "choose another"


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


def of_another_program(folder):
    """What other programs that use Hydra leave, too."""
    killed.older(folder)
    (folder / ".hydra/config.yaml").write_text("lr: 0.1\n")


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
    "no manifest": (killed.without_manifest, "notes.yaml"),
    "run of another program": (of_another_program, ".hydra/"),
    "older run with my figure": (both(killed.older, write("figures/a.png")), "figures/a.png"),
    "older run with a file": (both(killed.older, write("data.csv")), "data.csv"),
    "older run with another figure": (both(killed.older, write("figures/a.pdf")), "figures/a.pdf"),
    "half an older run": (
        both(killed.older, lambda folder: (folder / ".hydra/config.yaml").unlink()), ".hydra/",
    ),
    "only numbers": (
        lambda folder: [shutil.rmtree(folder), write("metrics.json")(folder)], "metrics.json",
    ),
}  # fmt: skip


class TestForeignFiles:
    @pytest.mark.parametrize(("make", "name"), FOREIGN.values(), ids=FOREIGN)
    def test_they_stay(self, root, tmp_path, monkeypatch, capsys, make, name):
        """One sentence names the file; all is as it was. So it is from within the folder."""
        folder = tmp_path / "run"
        killed.page(folder, 1.0)
        make(folder)
        before = snapshot(tmp_path)
        assert main([f"hydra.run.dir={folder}"], root) == 2
        words = sentence(capsys)
        assert f"holds {name}, which" in words
        assert REMEDY in words
        monkeypatch.chdir(folder)
        with pytest.raises(BadInput, match=re.escape(f"holds {name}, which")):
            check(Path("."))
        assert snapshot(tmp_path) == before

    def test_nothing_heavy_is_imported_before(self, root, tmp_path, monkeypatch, capsys):
        monkeypatch.setattr("srsinv.command.launch.load_job", None)  # would fail
        write("mine")(Path("."))
        assert main(["hydra.run.dir=."], root) == 2
        assert "holds mine, which no run of srsinv wrote" in sentence(capsys)

    def test_what_comes_in_while_the_job_runs(self, tmp_path):
        folder = tmp_path / "run"
        killed.page(folder, 1.0)
        with claim(folder) as workspace:
            write("late.txt")(folder)
            before = snapshot(folder)
            with pytest.raises(BadInput, match=r"holds late\.txt"):
                workspace.replace({"metrics.json": b"2"}, "srsinv", 0)
        assert snapshot(folder) == before
        assert os.listdir(tmp_path) == ["run"]

    def test_a_folder_that_goes_while_the_job_runs(self, tmp_path):
        with claim(tmp_path / "run") as workspace:
            (tmp_path / "run").rmdir()
            workspace.replace({"metrics.json": b"2"}, "srsinv", 0)
        assert (tmp_path / "run" / "metrics.json").read_bytes() == b"2"

    def test_a_sidecar_that_was_filled_in(self, tmp_path, monkeypatch, capsys):
        """Beside the recording, as the page tells to, and in the folder of the inspection."""
        write("scan.csv", "time_s,voltage_0_V\n")(tmp_path)
        write("scan.yaml", "polarity: -1\n")(tmp_path)
        monkeypatch.chdir(tmp_path)
        before = snapshot(tmp_path)
        arguments = ["experiment=inspect_recording", "recording.path=scan.csv"]
        assert main([*arguments, "hydra.run.dir=."], find_config_root()) == 2
        assert "holds scan.csv, which no run" in sentence(capsys)
        assert snapshot(tmp_path) == before


class TestEarlierRuns:
    @pytest.mark.parametrize("make", [lambda folder: None, killed.older])
    @pytest.mark.parametrize("place", ["by name", "by a link", "current", "around the current"])
    def test_are_replaced_as_a_whole(self, root, tmp_path, monkeypatch, make, place):
        folder = tmp_path / "run"
        killed.page(folder, 1.0)
        with claim(folder) as workspace:
            files = {**dict.fromkeys(killed.PAGE, b"x"), "figures/other.png": b"y"}
            workspace.replace(files, "srsinv", 1)
        make(folder)
        if place in ("current", "around the current"):
            monkeypatch.chdir(folder if place == "current" else folder / "figures")
        (tmp_path / "link").symlink_to("run")
        names = {"by name": folder, "by a link": tmp_path / "link", "current": "."}
        assert main([f"hydra.run.dir={names.get(place, '..')}", "value=5"], root) == 0
        assert json.loads((folder / "metrics.json").read_text()) == {"value": 5}
        assert {name for name in snapshot(folder) if "." in name[1:]} == {
            MANIFEST, "metrics.json", "result.nc", "report.html", "notes.yaml",
            "figures/signal.png", ".hydra/config.yaml", ".hydra/hydra.yaml",
            ".hydra/overrides.yaml",
        }  # fmt: skip
        assert not list(tmp_path.glob("**/*.srsinv"))
        assert (tmp_path / "link").is_symlink()

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

    def test_same_run_same_bytes(self, root, tmp_path, monkeypatch):
        """Elsewhere, too, and in folders named after the time."""
        assert main(["hydra.run.dir=a"], root) == 0
        assert main([], root) == 0
        (tmp_path / "there").mkdir()
        monkeypatch.chdir(tmp_path / "there")
        assert main([], root) == 0
        texts = [path.read_bytes() for path in tmp_path.rglob(MANIFEST)]
        assert len(texts) == 3
        assert len(set(texts)) == 1


# (folder as typed, what is there, words of the refusal)
PLACES = {
    "a long name": ("a" * 300, None, "File name too long"),
    "a long name further down": (f"new/{'a' * 300}/b", None, "File name too long"),
    "a long path": ("/".join(["a" * 100] * 50), None, "File name too long"),
    "a character that no name has": ("a\0b", None, "characters that are no text"),
    "half a character": ("a\udc80", None, "characters that are no text"),
    "another half": ("a\ud800", None, "characters that are no text"),
    "a link to itself": ("loop", lambda: Path("loop").symlink_to("loop"), "symbolic links"),
    "below it": ("loop/run", lambda: Path("loop").symlink_to("loop"), "symbolic links"),
    "a link that leads nowhere": ("link", lambda: Path("link").symlink_to("no"), "link to nothing"),
    "a file": ("file", lambda: Path("file").touch(), "is not a folder"),
    "a pipe": ("pipe", lambda: os.mkfifo("pipe"), "is not a folder"),
    "a folder in a file": ("file/run", lambda: Path("file").touch(), "is not a folder"),
    "a file in the workspace's place": (
        "file/.", lambda: Path("file").touch(), "is not a folder",
    ),
    "the folder above": ("..", None, "which no run of srsinv wrote"),
    "the root": ("/", None, "which no run of srsinv wrote"),
    "a system folder": ("/proc", None, "cannot write to /proc"),
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
    @pytest.mark.parametrize("flags", [[], ["-m"]])
    @pytest.mark.parametrize(("typed", "make", "words"), PLACES.values(), ids=PLACES)
    def test_that_no_run_can_have(self, root, tmp_path, capsys, typed, make, words, flags):
        if make:
            make()
        before = snapshot(tmp_path)
        key = "sweep" if flags else "run"
        assert main([*flags, f'hydra.{key}.dir="{typed}"'], root) == 2
        said = sentence(capsys)
        assert words in said or (flags and "cannot sweep into" in said)
        assert len(said) < 600
        assert snapshot(tmp_path) == before

    @pytest.mark.parametrize("typed", quick(POSSIBLE, "new/deep/run", "é"))
    def test_that_a_run_can_have(self, root, tmp_path, typed):
        folder = Path(os.path.realpath(typed))
        assert main([f'hydra.run.dir="{typed}"'], root) == 0
        assert (folder / MANIFEST).is_file()
        assert main([f'hydra.run.dir="{typed}"', "value=3"], root) == 0
        assert json.loads((folder / "metrics.json").read_text()) == {"value": 3}
        assert not list(tmp_path.glob("**/*.srsinv"))

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

    def test_over_one_without_manifests(self, root):
        assert sweep(root, "value=1,2") == 0
        for name in (MANIFEST, *GATHERED):
            Path("sweep", name).unlink()
        for i in range(2):
            killed.older(Path(f"sweep/{i}"))
        assert sweep(root, "value=3,4") == 0
        assert json.loads(Path("sweep/1/metrics.json").read_text()) == {"value": 4}

    @pytest.mark.parametrize(
        ("make", "name"),
        [
            (write("sweep/multirun.yaml"), "multirun.yaml"),
            (write("sweep/multirun.yaml", "hydra:\n"), "multirun.yaml"),
            (write("sweep/data.csv"), "data.csv"),
            (lambda _: killed.page(Path("sweep"), 1.0), ".hydra/"),
            (
                both(
                    lambda _: killed.page(Path("sweep"), 1.0), lambda _: killed.older(Path("sweep"))
                ),
                ".hydra/",
            ),
        ],
    )
    def test_not_over_anything_else(self, root, tmp_path, capsys, make, name):
        make(Path("."))
        before = snapshot(tmp_path)
        assert sweep(root, "value=1,2") == 2
        assert f"holds {name}" in sentence(capsys)
        assert snapshot(tmp_path) == before

    @pytest.mark.parametrize("name", ["multirun.yaml", "run.json", "mine"])
    def test_not_over_one_that_was_changed(self, root, tmp_path, capsys, name):
        assert sweep(root, "value=1,2") == 0
        append(f"sweep/{name}")(Path("."))
        before = snapshot(tmp_path)
        capsys.readouterr()
        assert sweep(root, "value=3,4") == 2
        assert f"holds {name}" in sentence(capsys)
        assert snapshot(tmp_path) == before

    def test_a_run_that_cannot_be_replaced_stays_and_the_others_go_on(self, root, capsys):
        assert sweep(root, "value=1,2,3") == 0
        write("sweep/1/data.csv")(Path("."))
        before = snapshot("sweep/1")
        assert sweep(root, "value=4,5,6") == 2
        assert "holds data.csv" in capsys.readouterr().err
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
        assert "holds 0/" in sentence(capsys)
        assert snapshot(tmp_path) == before
