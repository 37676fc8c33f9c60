"""Compiled programs in the cache folder: where, for whom, how many, and what may go wrong."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from jax.experimental.compilation_cache import compilation_cache as jax_cache

from srsinv.__main__ import main
from srsinv.command.compilation_cache import compilation_cache
from srsinv.errors import BadInput

CONFIG = """\
# One small program.
defaults:
  - _self_
  - override hydra/job_logging: none
  - override hydra/hydra_logging: none
job: experiments.compiled.run
compilation_cache: true
hydra:
  output_subdir: null
  run: {dir: run}
"""
JOB = """
import jax
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result

def run(cfg):
    return Result("Doubled", dataset(scalars({"y": float(jax.jit(lambda x: 2 * x)(2.0))}), {}))
"""


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A cache folder of its own for the user, and no cache that jax has been given already."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    jax_cache.reset_cache()
    yield tmp_path / "cache"
    jax.config.update("jax_compilation_cache_dir", before)
    jax_cache.reset_cache()


def entries(home: Path) -> list[Path]:
    return sorted(home.rglob("*-cache"))


def compile_one(factor: float) -> float:
    """A program for each `factor`, compiled or read anew at each call."""
    return float(jax.jit(lambda x: factor * x)(2.0))


def test_keeps_programs_for_the_user_alone(home):
    with compilation_cache(True):
        assert compile_one(3.0) == 6.0
    (entry,) = entries(home)
    for folder in (home / "srsinv", entry.parent):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert jax.config.jax_compilation_cache_dir is None
    compile_one(4.0)
    assert entries(home) == [entry]


def test_leaves_a_cache_of_the_users_own_alone(home, tmp_path):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "own"))
    with compilation_cache(True):
        compile_one(3.5)
        assert jax.config.jax_compilation_cache_dir == str(tmp_path / "own")
    assert not home.exists()


@pytest.mark.full
@pytest.mark.parametrize(("value", "is_cached"), [("true", True), ("false", False)])
def test_off_by_one_key(home, tmp_path, monkeypatch, value, is_cached):
    (tmp_path / "configs").mkdir()
    (tmp_path / "experiments").mkdir()
    (tmp_path / "configs/config.yaml").write_text(CONFIG)
    (tmp_path / "experiments/compiled.py").write_text(JOB)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "experiments", raising=False)
    monkeypatch.delitem(sys.modules, "experiments.compiled", raising=False)
    assert main([f"compilation_cache={value}"], tmp_path / "configs") == 0
    assert bool(entries(home)) == is_cached


def test_refuses_what_is_neither_on_nor_off():
    with pytest.raises(BadInput, match="true or false"), compilation_cache("maybe"):  # type: ignore
        pass


def _a_link(home):
    (home / "elsewhere").mkdir(parents=True, mode=0o700)
    (home / "srsinv").symlink_to(home / "elsewhere")


def _a_file(home):
    home.mkdir()
    (home / "srsinv").write_text("")


def _open_to_others(home):
    (home / "srsinv").mkdir(parents=True)
    (home / "srsinv").chmod(0o770)


@pytest.mark.parametrize(
    ("make", "reason"),
    [(_a_link, "a link"), (_a_file, "a file"), (_open_to_others, "open to other users")],
)
def test_an_unsafe_folder_is_not_used_and_the_run_goes_on(home, capsys, make, reason):
    make(home)
    with compilation_cache(True):
        assert compile_one(5.0) == 10.0
    assert not entries(home)
    said = capsys.readouterr().err
    assert reason in said
    assert said.count("\n") == 1


def test_a_folder_of_another_user_is_not_used(home, capsys, monkeypatch):
    (home / "srsinv").mkdir(parents=True, mode=0o700)
    owner = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    with compilation_cache(True):
        compile_one(6.0)
    assert not entries(home)
    assert "another user" in capsys.readouterr().err


def test_no_home_folder(home, capsys, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # which does not count
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    with compilation_cache(True):
        assert compile_one(7.0) == 14.0
    assert "no home folder" in capsys.readouterr().err


def test_folder_that_cannot_be_made(home, capsys):
    home.write_text("in the way")
    with compilation_cache(True):
        assert compile_one(8.0) == 16.0
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    "cut", [lambda data: data[: len(data) // 2], lambda data: b"", lambda d: d[::-1]]
)
def test_a_damaged_entry_is_compiled_again(home, capsys, cut):
    with compilation_cache(True):
        compile_one(9.0)
    (entry,) = entries(home)
    whole = entry.read_bytes()
    entry.write_bytes(cut(whole))
    for _ in range(2):  # it is removed by the first, written again by the second
        with compilation_cache(True):
            assert compile_one(9.0) == 18.0
    assert len(entry.read_bytes()) > len(whole) // 2
    assert capsys.readouterr().err == ""


def test_is_bounded_and_keeps_what_was_used_last(home):
    with compilation_cache(True):
        compile_one(10.0)
    (old,) = entries(home)
    os.utime(old, (1, 1))
    most = 3 * old.stat().st_size
    for factor in (11.0, 12.0, 13.0):
        with compilation_cache(True, most):
            compile_one(factor)
    left = entries(home)
    assert old not in left
    assert 0 < sum(each.stat().st_size for each in left) <= most


@pytest.mark.full
def test_processes_side_by_side(home):
    program = """
import jax
from srsinv.command.compilation_cache import compilation_cache
with compilation_cache(True):
    for factor in range(10):
        print(float(jax.jit(lambda x: factor * x)(2.0)))
"""
    expected = "".join(f"{2.0 * factor}\n" for factor in range(10))
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    started = [
        subprocess.Popen(
            [sys.executable, "-c", program], env=environment, stdout=-1, stderr=-1, text=True
        )
        for _ in range(2)
    ]
    assert [process.communicate() for process in started] == [(expected, "")] * 2
    assert len(entries(home)) == 10
