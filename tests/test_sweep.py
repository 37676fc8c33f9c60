"""Sweeps: what is missing is run, a failed job does not lose the others, by every launcher."""

import importlib.util
import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray

from srsinv.__main__ import find_config_root, main
from srsinv.command import sweeps
from srsinv.command.identity import identity
from srsinv.command.launchers import _own_folder
from srsinv.run_folder import FAILURES, GATHERED, MANIFEST
from tests.tiers import quick

CONFIG = """\
defaults:
  - _self_
  - override hydra/job_logging: none
  - override hydra/hydra_logging: none
job: experiments.quick.run
value: 1
seed: 0
scan: {path: null}
stuck: null
hydra:
  output_subdir: null
  run: {dir: outputs/run}
  sweep: {dir: sweep, subdir: "${hydra.job.num}"}
"""
JOB = """\
import os, signal, time
from srsinv.errors import refuse
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result

def run(cfg):
    value = cfg["value"]
    refuse(value == -1, "value is -1: give a value from 0.")
    if value == -2:
        raise RuntimeError("a fault of ours")
    if value == -3:
        os.kill(os.getpid(), signal.SIGKILL)
    while value == cfg["stuck"] and not os.path.exists("go"):
        time.sleep(0.05)
    threads = int(os.environ.get("NPROC", "0"))
    return Result("a run", dataset(scalars({"error": value / 10, "threads": threads}), {}))
"""
COMMAND = """\
import sys
from pathlib import Path
from srsinv.__main__ import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[2:], Path(sys.argv[1])))
"""
PARALLEL = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    "submitit_local": "hydra_plugins.hydra_submitit_launcher",
}
PATIENCE_S = 120


@pytest.fixture
def root(tmp_path, monkeypatch):
    """The configuration of a quick job, and an empty current folder."""
    for path, text in (("configs/config.yaml", CONFIG), ("experiments/quick.py", JOB)):
        (tmp_path / path).parent.mkdir()
        (tmp_path / path).write_text(text)
    (tmp_path / "away").mkdir()
    monkeypatch.chdir(tmp_path / "away")
    return tmp_path / "configs"


@pytest.fixture
def run(root, capsys):
    """Sweeps; gives the exit code, the jobs that were begun and what was said on standard error."""

    def sweep(*arguments):
        code = main(["-m", *arguments], root)
        said = capsys.readouterr()
        lines = [line for line in said.out.splitlines() if line.startswith("job ")]
        return code, [line.partition(": ")[2] for line in lines], said.err

    return sweep


def gathered() -> xarray.Dataset:
    with xarray.open_dataset(Path("sweep", GATHERED[0]), engine="h5netcdf") as data:
        return data.load()


def needs(launcher: str) -> None:
    has_plugins = importlib.util.find_spec("hydra_plugins") is not None
    if not (has_plugins and importlib.util.find_spec(PARALLEL[launcher])):
        pytest.skip(f"needs {PARALLEL[launcher].partition('.')[2].replace('_', '-')}")


@pytest.mark.parametrize("name", quick([GATHERED[1], "multirun.yaml", MANIFEST], GATHERED[1]))
def test_what_comes_into_its_folder_meanwhile_stays(run, monkeypatch, name):
    def come_in(*arguments):
        Path("sweep/mine").mkdir()
        Path("sweep", name).write_text("precious")
        return gather(*arguments)

    gather = sweeps._gathered
    monkeypatch.setattr(sweeps, "_gathered", come_in)
    assert run("value=1")[0] == 2
    assert Path("sweep", name).read_text() == "precious"
    assert Path("sweep/mine").is_dir()


def test_what_launchers_unpickle_is_in_a_new_folder(tmp_path):
    """A folder of somebody else may hold pickles under the names that submitit gives its own."""
    (tmp_path / ".submitit").symlink_to("/")
    made = [_own_folder(str(tmp_path / ".submitit" / "%j")) for _ in range(2)]
    assert made[0] != made[1]
    for folder in made:
        assert folder.name == "%j"
        assert folder.parents[1] == tmp_path
        assert not any(folder.parent.iterdir())
        assert stat.S_IMODE(folder.parent.stat().st_mode) == 0o700


def test_data_below_the_users_folder_decide_on_a_job(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    settings = {"recording": {"path": "~/scan.csv"}}
    names = set()
    for text in ("a", "b"):
        (tmp_path / "scan.csv").write_text(text)
        names.add(identity(settings, None))
    assert len(names) == 2


class TestMissing:
    @pytest.mark.full
    def test_only_what_failed_runs_again(self, run):
        code, begun, said = run("value=1,-2,2,-1")
        assert code == 1
        assert begun == ["value=1", "value=-2", "value=2", "value=-1"]
        assert "2 of 4 jobs failed" in said
        assert "job 1: value=-2: RuntimeError: a fault of ours" in said
        assert "job 3: value=-1: value is -1: give a value from 0." in said
        assert gathered()["status"].values.tolist() == ["done", "failed", "done", "failed"]
        assert run("value=1,-2,2,-1")[1] == ["value=-2", "value=-1"]

    @pytest.mark.full
    def test_more_values_go_to_folders_of_their_own(self, run):
        """A job is known by its configuration, wherever it stands in the sweep."""
        assert run("value=2,3")[0] == 0
        assert run("value=1,2,3,4") == (0, ["value=1", "value=4"], "")
        data = gathered()
        assert dict(zip(data["value"].values, data["job"].values, strict=True)) == {
            1: "4", 2: "0", 3: "1", 4: "3",
        }  # fmt: skip
        assert run("value=1,2,3,4") == (0, [], "")
        assert not Path("sweep", FAILURES).exists()

    @pytest.mark.full
    def test_the_number_is_the_jobs_own(self, run):
        """Also of what the configuration makes of it."""
        run("seed=${hydra:job.num}", "value=1,-1,2,-1")
        seeds = [json.loads(Path("sweep", n, MANIFEST).read_text())["seed"] for n in "02"]
        assert seeds == [0, 2]

    def test_a_configuration_runs_once(self, run):
        assert run("value=1,2,1") == (0, ["value=1", "value=2"], "")

    @pytest.mark.full
    def test_a_changed_file_of_data_makes_another_job(self, run):
        Path("scan.csv").write_text("1,2\n")
        Path("scan.json").write_text("{}")
        sweep = ("scan.path=scan.csv", "value=1")
        assert run(*sweep)[1] == ["scan.path=scan.csv value=1"]
        for name in ("scan.csv", "scan.json"):
            assert not run(*sweep)[1]
            Path(name).write_text("[2, 3]\n")
            assert run(*sweep)[1] == ["scan.path=scan.csv value=1"]

    @pytest.mark.full
    def test_another_version_makes_another_job(self, run):
        run("value=1,2")
        path = Path("sweep/1", MANIFEST)
        document = json.loads(path.read_text()) | {"version": "0.0.1"}
        path.write_text(json.dumps(document, sort_keys=True, indent=2) + "\n")
        assert run("value=1,2")[1] == ["value=2"]

    @pytest.mark.full
    def test_half_a_folder_is_no_run(self, run):
        run("value=1,2")
        Path("sweep/0/result.nc").unlink()
        assert run("value=1,2")[1] == ["value=1"]

    @pytest.mark.full
    def test_what_was_gathered_is_the_sweeps_own(self, run):
        """A page that was changed is not overwritten."""
        run("value=1,2")
        with Path("sweep", GATHERED[1]).open("a") as page:
            page.write("a note")
        code, begun, said = run("value=1,2,3")
        assert (code, begun) == (2, [])
        assert f"holds {GATHERED[1]}" in said


@pytest.mark.full
class TestLaunchers:
    # By submitit it has closed pytest's own streams when other tests ran before it.
    @pytest.mark.claim
    @pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
    def test_a_job_that_dies_does_not_lose_the_others(self, run, monkeypatch, launcher):
        needs(launcher)
        monkeypatch.delenv("NPROC", raising=False)
        is_joblib = launcher == "joblib"
        values = "1,2,-3,-1,3" if is_joblib else "1,-3,-1,2"
        count = "hydra.launcher.n_jobs=2" if is_joblib else "hydra.sweeper.max_batch_size=4"
        code, _, said = run(f"hydra/launcher={launcher}", f"value={values}", count)
        assert code == 1
        data = gathered()
        is_done = data["status"].values == "done"
        assert data["value"].values[is_done].tolist() == [v for v in data["value"] if v > 0]
        assert sum(is_done) == values.count(",") - 1
        assert all(data["threads"].values[is_done] >= 1)
        assert "value=-3: its process ended without a result, killed" in said
        assert "value=-1: value is -1: give a value from 0." in said
        # Called again, by another launcher too: only what is missing.
        assert run(f"value={values.replace('-3', '5')}")[1] == ["value=5", "value=-1"]

    def test_killed_and_called_again(self, run, root, tmp_path):
        needs("joblib")
        script = tmp_path / "command.py"
        script.write_text(COMMAND)
        typed = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "value=1,2,3,4", "stuck=3"]
        process = subprocess.Popen(
            [sys.executable, script, root, "-m", *typed], start_new_session=True
        )
        latest = time.monotonic() + PATIENCE_S
        while not all(Path(f"sweep/{i}", MANIFEST).exists() for i in (0, 1, 3)):
            assert process.poll() is None
            assert time.monotonic() < latest
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        assert not Path("sweep/2", MANIFEST).exists()
        Path("go").touch()
        code, begun, _ = run("value=1,2,3,4", "stuck=3")
        assert (code, begun) == (0, ["value=3 stuck=3"])
        assert gathered()["value"].values.tolist() == [1, 2, 3, 4]
        assert not list(Path("sweep").glob(".*.srsinv"))


@pytest.mark.full
@pytest.mark.parametrize(
    ("launcher", "package"), [("parallel", "joblib"), ("slurm", "submitit_local")]
)
def test_the_launchers_of_the_extras_compose(launcher, package, capsys):
    needs(package)
    assert main([f"hydra/launcher={launcher}", "--cfg", "hydra"]) == 0
    assert "_target_: hydra_plugins." in capsys.readouterr().out


def test_a_launcher_whose_package_is_absent_names_the_extra(run, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    code, begun, said = run("hydra/launcher=joblib", "value=1,2")
    assert (code, begun) == (2, [])
    assert 'pip install "srsinv[parallel]"' in said
    assert (find_config_root() / "hydra" / "launcher" / "parallel.yaml").is_file()
