"""The command line on a small configuration of its own: runs, sweeps, refusals, what stays behind,
and the page."""

import json
import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray
from hydra.core.override_parser.overrides_parser import OverridesParser
from jinja2 import UndefinedError
from matplotlib.figure import Figure

from srsinv.__main__ import find_config_root, main
from srsinv.command.typed import _unreadable
from srsinv.report.data import dataset, metrics_json, scalars
from srsinv.report.files import render
from srsinv.report.result import Result
from srsinv.report.section import WrittenSection
from srsinv.report.terminal import print_table
from srsinv.report.text import format_value
from srsinv.report.words import Table
from srsinv.run_folder import RunRecord, claim
from tests.tiers import quick

CONFIG = """\
# What the default run shows.
# srsinv

defaults:
  - _self_
  - sensor: one
  - experiment: null
  - override hydra/job_logging: none
  - override hydra/hydra_logging: none

job: experiments.measured.run
seed: 0
loud: false
recording: {path: null}
note: null
parts: {}

hydra:
  output_subdir: null
  run:
    dir: outputs/${hydra.job.name}/run
  sweep:
    dir: outputs/${hydra.job.name}/sweep
    subdir: ${hydra.job.num}
"""

EXPERIMENTS = {
    "shown": "# Shows the clone's own job.\njob: experiments.shown.run\nseed: 7\n",
    "constructed": "# Refuses.\njob: experiments.constructed.run\n",
    "faulty": "# Breaks.\njob: experiments.faulty.run\n",
    "packaged": "# Runs anywhere.\njob: srsinv.jobs.simulate.run\n",
    "lacking": "# Needs a value.\nneeded: ???\n",
    "dangling": "# Refers to nothing.\nseed: ${nothing.here}\n",
}

JOBS = {
    "measured": """
from srsinv.errors import BadInput, refuse
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import WrittenSection

def run(cfg):
    depth_m = cfg["sensor"]["depth_m"]
    refuse(depth_m <= 0, f"depth_m is {depth_m}, not above 0; give a depth in metres")
    metrics = scalars({"depth_m": depth_m, "seed": cfg["seed"]})
    data = dataset({"p": ("x", [1.0, 2.0], "Pa"), **metrics}, {})
    words = '{{ table({"method": ["wiener"], "error": [0.25]}) }}'
    return Result("A measurement", data, (WrittenSection(words=words),))
""",
    "shown": """
from . import measured

def run(cfg):
    return measured.run(cfg)
""",
    "constructed": """
from srsinv.errors import BadInput

def run(cfg):
    raise BadInput("gain is 0; give a gain above 0")
""",
    "faulty": """
def run(cfg):
    raise RuntimeError("a fault of ours")
""",
}


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A configuration folder beside `experiments`, with an empty current folder."""
    folders = {name: tmp_path / name for name in ("configs", "experiments", "away")}
    for path in (
        *folders.values(),
        folders["configs"] / "sensor",
        folders["configs"] / "experiment",
    ):
        path.mkdir()
    (folders["configs"] / "config.yaml").write_text(CONFIG)
    for name, depth_m in (("one", 1e-3), ("two", 2e-3)):
        (folders["configs"] / "sensor" / f"{name}.yaml").write_text(f"depth_m: {depth_m}\n")
    for name, text in EXPERIMENTS.items():
        path = folders["configs"] / "experiment" / f"{name}.yaml"
        path.write_text(f"# @package _global_\n{text}")
    for name, text in JOBS.items():
        (folders["experiments"] / f"{name}.py").write_text(text)
    monkeypatch.chdir(folders["away"])
    return folders["configs"]


def files(folder="."):
    return {p.relative_to(folder).as_posix() for p in Path(folder).rglob("*") if p.is_file()}


RESULTS = {
    "metrics.json",
    "result.nc",
    "report.html",
    "run.json",
    ".hydra/config.yaml",
    ".hydra/overrides.yaml",
    ".hydra/hydra.yaml",
}


class TestRun:
    def test_leaves_every_file_and_ends_with_the_folder(self, root, capsys):
        assert main(["sensor=two"], root) == 0
        *table, report, folder = capsys.readouterr().out.splitlines()
        assert folder == str(Path("outputs/default/run").absolute())
        assert report == f"{folder}/report.html"
        assert re.search(r"wiener +\| +0\.25", "\n".join(table))
        assert files(folder) == RESULTS
        assert json.loads(Path(folder, "metrics.json").read_text()) == {"depth_m": 2e-3, "seed": 0}
        assert Path(folder, ".hydra/overrides.yaml").read_text() == "- sensor=two\n"
        assert "srsinv sensor=two" in Path(report).read_text()

    def test_experiment_beside_the_configs_from_any_folder(self, root, capsys):
        assert main(["experiment=shown", "sensor.depth_m=3e-3"], root) == 0
        folder = Path(capsys.readouterr().out.splitlines()[-1])
        assert folder == Path("outputs/shown/run").absolute()
        assert json.loads((folder / "metrics.json").read_text()) == {"depth_m": 3e-3, "seed": 7}

    def test_same_run_same_bytes(self, root):
        pages = []
        for folder in ("a", "b"):
            assert main([f"hydra.run.dir={folder}"], root) == 0
            names = sorted(RESULTS - {"run.json"})[3:]  # which has a date
            pages.append([Path(folder, name).read_bytes() for name in names])
        assert pages[0] == pages[1]

    @pytest.mark.parametrize(
        "override",
        ["+parts.extra={a: 1}", "++seed=3", "sensor={depth_m: 2}", "note='a b'"],
    )
    def test_overrides_that_fit(self, root, override):
        assert main([override], root) == 0

    def test_shows_the_configuration(self, root, capsys):
        assert main(["--cfg", "job", "sensor=two"], root) == 0
        assert "depth_m: 0.002" in capsys.readouterr().out
        assert files() == set()

    def test_options_from_a_folder_of_the_users_own(self, root, tmp_path, capsys):
        (tmp_path / "mine's" / "sensor").mkdir(parents=True)
        (tmp_path / "mine's" / "sensor" / "own.yaml").write_text("depth_m: 5e-3\n")
        assert main(["--config-dir", str(tmp_path / "mine's"), "sensor=own"], root) == 0
        folder = Path(capsys.readouterr().out.splitlines()[-1])
        assert json.loads((folder / "metrics.json").read_text())["depth_m"] == 5e-3


REFUSALS = {
    "experiment=show": r"no experiment 'show'; the nearest is 'shown'; choose one of .*constructed",
    "sensor=three": r"no sensor 'three'; choose one of one, two$",
    "sensor=null": r"chooses nothing",
    "~sensor": r"would leave no sensor",
    "sensor.dept_m=1": r"no key 'sensor\.dept_m'; the nearest is 'sensor\.depth_m'",
    "depth_m=1": r"no key 'depth_m'; the nearest is 'sensor\.depth_m'",
    "+sensor.x=1": r"no key 'sensor\.x'; 'sensor' has depth_m",
    "+sensor={dept_m: 1}": r"no key 'sensor\.dept_m'; the nearest is 'sensor\.depth_m'",
    "sensor={depth_m: deep}": r"'sensor\.depth_m' takes a number, not 'deep'",
    "+unknown=1": r"no key 'unknown'; srsinv --cfg job lists all",
    "++unknown=1": r"no key 'unknown'",
    "~seed": r"'~seed' would remove",
    "hydra.run.dr=x": r"no key 'hydra\.run\.dr'; the nearest is 'hydra\.run\.dir'",
    "sensor.depth_m=0.7mm": r"'sensor\.depth_m' takes a number, not '0\.7mm'; it is 0\.001",
    "loud=3": r"'loud' takes true or false, not 3",
    "recording=3": r"'recording' takes its own keys \(path\), not 3",
    "seed=1,2": r"'seed=1,2' gives several values; sweep over them with -m",
    "seed=[1": r"cannot read 'seed=\[1' as key=value",
    "=1": r"cannot read '=1'",
    "seed": r"cannot read 'seed'",
    "experiment=lacking": r"'needed' has no value; give one with needed=VALUE",
    "experiment=dangling": r"Interpolation key 'nothing\.here' not found",
    "hydra.job.num=x": r"could not be converted to Integer",
    "sensor@other=one": r"Could not override 'sensor@other'",
    "sensor.depth_m=-1": r"depth_m is -1, not above 0",
    "experiment=constructed": r"^srsinv: gain is 0; give a gain above 0$",
    "job=3": r"job is 3, which is not the function",
    "job=nowhere.run": r"job is 'nowhere\.run', which is not the function",
    "job=os.system": r"job is 'os\.system', which is not the function",
    "job=experiments.absent.run": r"job is 'experiments\.absent\.run', which is not the function",
    "job=experiments.measured.refuse": r"'experiments\.measured\.refuse', which is not the",
    "job=srsinv.errors.refuse": r"job is 'srsinv\.errors\.refuse', which is not the function",
    "hydra.run.dir=../experiments/faulty.py/a": r"cannot write to \.\./experiments/faulty\.py/a",
    "+hydra.callbacks.x={_target_: os.system}": r"hydra\.callbacks names",
    "hydra.launcher._target_=os.system": r"hydra\.launcher names 'os\.system', .*BasicLaunch",
    "hydra.sweeper._target_=os.system": r"hydra\.sweeper names 'os\.system'",
    "hydra.searchpath=[pkg://json]": r"srsinv does not use hydra\.searchpath: .*--config-dir",
    "hydra={searchpath: [pkg://json]}": r"hydra\.searchpath",
    "+hydra.job.env_set.LD_PRELOAD=x.so": r"srsinv does not use hydra\.job\.env_set",
    "hydra.job.env_copy=[NOPE]": r"srsinv does not use hydra\.job\.env_copy",
    "hydra.sweeper.params={seed: 3}": r"srsinv does not use hydra\.sweeper\.params: .*-m key=a,b",
    "hydra.sweeper.max_batch_size=0": r"max_batch_size is 0: give a whole number from 1",
    "sensor=[]": r"'sensor=\[\]' would leave no sensor; choose one of one, two",
    "experiment=[]": r"'experiment=\[\]' would leave no experiment",
    "recording.path=scan.csv": r"recording\.path is given, but this job reads no recording",
    "hydra/job_logging=default": r"hydra\.job_logging sets up loggers",
    "hydra.output_subdir=x": r"srsinv does not use hydra\.output_subdir",
    "seed=-1": r"seed is -1: give a whole number",
    "seed=1e400": r"seed is inf: give a whole number",
    "seed=" + "[" * 3000: r"has 3005 characters in 3000 levels of brackets",
    "seed=" + "1" * 200_000: r"has 200005 characters",
    "recording.path=a\0b": r"bytes that are not UTF-8",
    "recording.path=a\udcff": r"bytes that are not UTF-8",
    "help": r"'help' is not key=value; type srsinv --help",
    "version": r"'version' is not key=value; type srsinv --version",
    "shown": r"'shown' is not key=value; type srsinv experiment=shown",
    "--versio": r"unrecognized arguments: --versio",
    "--multi": r"unrecognized arguments: --multi",
    "--shell-completion": r"--shell-completion takes one of install=SHELL",
    "--bogus": r"unrecognized arguments: --bogus",
    "--config-name=other": r"--config-name is not for srsinv",
    "--config-dir=" + "a" * 300: r"--config-dir a+ is not a folder",
    "--config-dir=absent": r"--config-dir absent is not a folder",
}


def one_sentence(capsys):
    captured = capsys.readouterr()
    assert captured.out == ""
    assert re.fullmatch(r"srsinv: .*\n", captured.err)
    return captured.err


ODD_NAMES = ["run (1).csv", "a=b.csv", "~x.csv", "[a].csv", "ß.csv", "o'x(.csv", "$x (1).csv"]


@pytest.mark.parametrize("path", ODD_NAMES)
def test_a_path_that_needs_quotation_marks_is_typed_as_the_refusal_says(path):
    refusal = _unreadable(f"recording.path={path}")
    (typed,) = shlex.split(refusal[refusal.index(": ") + 2 :])
    parsed = OverridesParser.create().parse_override(typed)
    assert (parsed.key_or_group, str(parsed.value())) == ("recording.path", path)


class TestRefusals:
    @pytest.mark.parametrize("argument", quick(REFUSALS, *[*REFUSALS][::3]))
    def test_one_sentence_and_nothing_left(self, root, capsys, argument):
        sentence = REFUSALS[argument]
        before = os.listdir(root.parent)
        assert main([argument], root) == 2
        assert re.search(sentence, one_sentence(capsys))
        assert os.listdir(".") == []
        assert os.listdir(root.parent) == before

    def test_what_was_there_stays(self, root):
        Path("mine/empty").mkdir(parents=True)
        Path("mine/notes.txt").write_text("kept")
        for folder in ("mine", "mine/empty", "mine/new/newer"):
            assert main(["sensor.depth_m=-1", f"hydra.run.dir={folder}"], root) == 2
        assert sorted(str(path) for path in Path("mine").rglob("*")) == [
            "mine/empty",
            "mine/notes.txt",
        ]

    def test_experiment_of_a_clone_without_the_clone(self, root, capsys):
        (root.parent / "experiments").rename(root.parent / "elsewhere")
        assert main(["experiment=shown"], root) == 2
        assert "runs only in a clone of the repository" in one_sentence(capsys)

    def test_a_fault_keeps_its_traceback(self, root, capsys):
        assert main(["experiment=faulty"], root) == 1
        assert "RuntimeError: a fault of ours" in capsys.readouterr().err
        assert os.listdir(".") == []

    def test_a_missing_import_of_a_job_is_a_fault(self, root, capsys):
        (root.parent / "experiments" / "shown.py").write_text("import absent_module\n")
        assert main(["experiment=shown"], root) == 1
        assert "No module named 'absent_module'" in capsys.readouterr().err


CODE = "{_target_: builtins.open, file: CALLED, mode: w}"
CALLED = "{'()': builtins.open, file: CALLED, mode: w}"
# Options of hydra/GROUP in a folder of one's own, through which Hydra would call what they name.
CALLING = {
    **{
        f"{group}, {root}, {called}": (group, f"{{version: 1, {root}, {called}}}")
        for group in ("hydra_logging", "job_logging")
        for root in ("root: {}", "root: {handlers: []}", "root: false", "root: null")
        for called in (f"formatters: {{x: {CALLED}}}", f"filters: {{x: {CALLED}}}",
                       f"handlers: {{x: {CALLED}}}",
                       "handlers: {x: {class: logging.FileHandler, filename: CALLED}}")
    },
    "callbacks": ("callbacks", f"{{x: {CODE}}}"),
    "launcher": ("launcher", CODE),
    "launcher's part": (
        "launcher",
        f"{{_target_: hydra._internal.core_plugins.basic_launcher.BasicLauncher, x: {CODE}}}",
    ),
    "launcher's part elsewhere": (
        "launcher",
        "{_target_: hydra._internal.core_plugins.basic_launcher.BasicLauncher, x: '${parts}'}",
    ),
    "sweeper's part, decoded": (
        "sweeper",
        "{_target_: hydra._internal.core_plugins.basic_sweeper.BasicSweeper, "
        "max_batch_size: null, params: \"${oc.decode:'{_target_: builtins.print}'}\"}",
    ),
}  # fmt: skip


LOGGERS = next(iter(CALLING))


@pytest.mark.parametrize(
    ("flag", "case"),
    quick(
        [("", case) for case in CALLING]
        + [(flag, case) for flag in ("--info all", "-m") for case in [*CALLING][::5]],
        ("", LOGGERS),
        ("", "launcher's part elsewhere"),
    ),
)
def test_an_option_of_hydra_calls_nothing(root, capsys, case, flag):
    group, text = CALLING[case]
    (root.parent / "mine" / "hydra" / group).mkdir(parents=True)
    (root.parent / "mine" / "hydra" / group / "own.yaml").write_text(text)
    parts = "+parts={_target_:builtins.open,file:CALLED,mode:w}"
    given = ["--config-dir", str(root.parent / "mine"), f"hydra/{group}=own", parts]
    assert main([*flag.split(), *given], root) == 2
    one_sentence(capsys)
    assert os.listdir(".") == []


# Files of options that nobody can read, or not in a lifetime.
BOMB = "\n".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 9))
OPTIONS = {
    "a bomb of aliases": f"a0: &a0 1\n{BOMB}\n",
    "an alias of itself": "a: &a [*a]\n",
    "an alias of nothing": "a: *b\n",
    "300 kB": "#" * 300_000,
    "nested": "a: " + "[" * 2000 + "]" * 2000,
    "no text": b"\xff\xfea",
    "zeros": bytes(100),
    "one key twice": "depth_m: 1\ndepth_m: 2\n",
    "an object of Python": "depth_m: !!python/object/apply:os.getcwd []\n",
    "a tab": "a:\n\tb: 1\n",
    "itself as a default": "defaults: [own]\n",
}  # fmt: skip


@pytest.mark.parametrize("case", quick(OPTIONS, "a bomb of aliases", "no text"))
def test_a_file_of_options_that_cannot_be_read(root, capsys, case):
    content = OPTIONS[case]
    (root.parent / "mine" / "sensor").mkdir(parents=True)
    (root.parent / "mine" / "sensor" / "own.yaml").write_bytes(
        content if isinstance(content, bytes) else content.encode()
    )
    assert main(["--config-dir", str(root.parent / "mine"), "sensor=own"], root) == 2
    one_sentence(capsys)
    assert os.listdir(".") == []


class TestSweep:
    def test_every_job_has_its_folder(self, root, capsys):
        assert main(["-m", "sensor=one,two", "seed=5"], root) == 0
        sweep = Path("outputs/default/sweep").absolute()
        assert capsys.readouterr().out.splitlines()[-1] == str(sweep)
        metrics = [json.loads((sweep / str(i) / "metrics.json").read_text()) for i in (0, 1)]
        assert [each["depth_m"] for each in metrics] == [1e-3, 2e-3]
        assert files(sweep / "1") == RESULTS

    def test_a_refused_job_leaves_the_others(self, root, capsys):
        assert main(["-m", "sensor.depth_m=1,-1,2"], root) == 2
        assert "depth_m is -1" in capsys.readouterr().err
        assert sorted(os.listdir("outputs/default/sweep")) == [
            "0",
            "2",
            "failures.json",
            "multirun.yaml",
            "run.json",
            "sweep.html",
            "sweep.nc",
        ]

    @pytest.mark.parametrize(
        ("arguments", "code"),
        [
            (["sensor.depth_m=-1,-2"], 2),
            (["sensor=one,tow"], 2),
            (["sensor.depth_m=1,x"], 2),
            (["experiment=lacking,dangling"], 2),
            (["experiment=faulty,constructed"], 1),
        ],
    )
    def test_nothing_done_nothing_left(self, root, arguments, code):
        assert main(["-m", *arguments], root) == code
        assert os.listdir(".") == []

    def test_a_record_that_was_there_stays(self, root):
        Path("mine").mkdir()
        Path("mine/multirun.yaml").write_text("kept")
        assert main(["-m", "sensor.depth_m=-1,-2", "hydra.sweep.dir=mine"], root) == 2
        assert os.listdir("mine") == ["multirun.yaml"]
        assert Path("mine/multirun.yaml").read_text() == "kept"


class TestHelp:
    def test_lists_experiments_and_groups(self, root, capsys):
        assert main(["--help"], root) == 0
        text = capsys.readouterr().out
        assert re.search(r"^  shown +Shows the clone's own job\.$", text, re.MULTILINE)
        assert re.search(r"^  \(none\) +What the default run shows\.$", text, re.MULTILINE)
        assert re.search(r"^  sensor= +one, two$", text, re.MULTILINE)

    def test_hides_what_cannot_run(self, root, capsys):
        (root.parent / "experiments").rename(root.parent / "elsewhere")
        assert main(["-h"], root) == 0
        text = capsys.readouterr().out
        assert "shown " not in text
        assert "packaged" in text

    def test_of_the_real_command_is_quick_and_light(self, tmp_path):
        program = (
            "import sys; from srsinv.__main__ import main; code = main(['--help']);"
            "heavy = {'hydra', 'jax', 'omegaconf', 'matplotlib', 'numpy'} & set(sys.modules);"
            "sys.exit(code or ' '.join(heavy) or 0)"
        )
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
        started_s = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-c", program],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert time.perf_counter() - started_s < 1
        assert (done.returncode, done.stderr) == (0, "")
        assert "experiments (experiment=NAME)" in done.stdout

    def test_every_real_experiment_can_be_listed(self):
        """Hydra reads `@package` in the first line only, and help the comment after it."""
        for path in (find_config_root() / "experiment").glob("*.yaml"):
            package, summary, command, *_ = path.read_text().splitlines()
            assert package == "# @package _global_", path.name
            assert re.fullmatch(r"# [A-Z].*\.", summary), path.name
            assert command.startswith(f"# srsinv experiment={path.stem}"), path.name


def test_refused_by_the_real_command(tmp_path):
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-m", "srsinv", "sede=1"],
        cwd=tmp_path, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "srsinv: there is no key 'sede'; the nearest is 'seed'\n"
    assert list(tmp_path.iterdir()) == []


FIGURE = "{{ figure('one', own.plots.draw, 'A caption.') }}"


def draw(dataset):
    figure = Figure(figsize=(2, 1))
    figure.add_subplot().plot([0, 1], [0, 1])
    return figure


def result(**changes):
    parts = {
        "title": "Ridges & <steps>",
        "dataset": dataset(
            {
                "p": ("x", np.ones(2), "Pa"),
                **scalars({"rmse_p_Pa": 1.5, "blind": float("nan"), "count": np.int64(3)}),
            },
            {},
        ),
        "sections": (
            WrittenSection(words='{{ table({"method": ["wiener"]}) }}'),
            section("First", """a < b\n\n{{ figure("one", own.plots.draw, 'A "line".') }}"""),
            section("Second", '{{ table({"n": [1], "name": ["<i>"]}, "Rows") }}'),
        ),
    }
    return Result(**(parts | changes))


def section(heading, words, draw=draw):
    return WrittenSection(heading, words=words, plots={"draw": draw})


def write(made, folder, record, command="srsinv"):
    with claim(folder) as workspace:
        workspace.replace(render(made, record, command), RunRecord(command, 0))


class TestPage:
    def test_is_escaped_self_contained_and_in_order(self, tmp_path):
        write(result(), tmp_path / "run", {"config.yaml": "a: 1\n"}, "srsinv a='<b>'")
        page = (tmp_path / "run" / "report.html").read_text()
        assert "<h1>Ridges &amp; &lt;steps&gt;</h1>" in page
        assert "srsinv a=&#39;&lt;b&gt;&#39;" in page
        assert page.index("First</h2>") < page.index("Second</h2>")
        assert "<td>&lt;i&gt;</td>" in page
        assert '<td class="number">1</td>' in page
        assert page.count("data:image/png;base64,") == 1
        assert not re.search(r"https?://|<script|<link", page)

    def test_same_result_same_bytes(self, tmp_path):
        for name in ("a", "b"):
            write(result(), tmp_path / name, {})
        for name in ("report.html", "figures/one.png", "metrics.json", "result.nc"):
            assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()

    def test_further_files_are_beside_the_page(self, tmp_path):
        write(result(files={"scan.yaml": "gain: null # µ\n"}), tmp_path / "run", {})
        assert (tmp_path / "run" / "scan.yaml").read_text(encoding="utf-8") == "gain: null # µ\n"

    def test_arrays_come_back_with_units(self, tmp_path):
        write(result(), tmp_path, {})
        with xarray.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as data:
            assert data.p.attrs["units"] == "Pa"
            np.testing.assert_array_equal(data.p, [1.0, 1.0])

    @pytest.mark.parametrize(
        ("changes", "error", "text"),
        [
            ({"dataset": xarray.Dataset({"p": ("x", [1.0])})}, ValueError, "without units.*p"),
            (
                {
                    "sections": (
                        section("s", "{{ figure('f', own.plots.draw, '') }}", lambda _: 1 / 0),
                    )
                },
                ZeroDivisionError,
                "division",
            ),
            ({"sections": (section("s", "{{ ds.nothing }}"),)}, UndefinedError, "nothing"),
        ],
    )
    def test_all_or_nothing(self, tmp_path, changes, error, text):
        folder = tmp_path / "run"
        write(result(), folder, {})
        before = {name: (folder / name).read_bytes() for name in files(folder)}
        with pytest.raises(error, match=text):
            write(result(title="Later", **changes), folder, {})
        assert {name: (folder / name).read_bytes() for name in files(folder)} == before
        assert os.listdir(tmp_path) == ["run"]


def test_metrics_are_sorted_and_finite():
    text = metrics_json({"b": float("inf"), "a": 1, "c": 0.5, "d": True, "e": None})
    assert text == '{\n  "a": 1,\n  "b": null,\n  "c": 0.5,\n  "d": true,\n  "e": null\n}\n'


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-0.0, "0"),
        (12, "12"),
        (1234567, "1234567"),
        (12.3456, "12.35"),
        (0.00075, "750e-6"),
        (0.00099996, "1e-3"),
        (-2.3e-11, "-23e-12"),
        (54321.4, "54321"),
        (123456.0, "123.5e3"),
        (999_960.0, "1e6"),
        (5e-324, "4.941e-324"),
        (float("nan"), "–"),
        (None, "–"),
        (True, "yes"),
        ("text", "text"),
    ],
)
def test_number_format(value, text):
    assert format_value(value) == text


def test_wide_table_is_whole_when_piped(capsys):
    columns = tuple(f"a rather long heading {i}" for i in range(12))
    print_table(Table(columns, (tuple(range(12)),), "[bold]Caption"))
    heading, _, row, caption = capsys.readouterr().out.splitlines()
    assert caption == "[bold]Caption"
    assert [cell.strip() for cell in heading.strip("|").split("|")] == list(columns)
    assert len(row) == len(heading)
