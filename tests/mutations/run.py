"""Runs tests on a copy of the tree with one mutation at a time: which of them notice it?

Every run of pytest is a fork of one process that has imported jax and the like, but nothing of
srsinv: importing them takes longer than most tests.
"""

import multiprocessing
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from .table import ROOT, Mutation

TIERS = {"test": "not full and not claim", "all": "not claim"}
LONGEST_S = 600  # of processor time: a mutation may well make a search endless
DIED = "pytest died"  # in place of a test: of that, or of an error that ends Python itself
PRELOADED = (
    *("jax", "jaxtyping", "beartype", "equinox", "optimistix", "optax", "mpmath"),
    *("scipy.signal", "scipy.optimize", "scipy.stats", "scipy.interpolate", "scipy.ndimage"),
    *("xarray", "h5py", "pydantic", "pytest"),
)


class Copy:
    """A copy of the working tree, in which one mutation at a time is made and taken back."""

    def __init__(self, folder: Path, arguments: Sequence[str] = ()):
        """`arguments` are further ones of pytest's."""
        self._folder, self._tree, self._arguments = folder, folder / "tree", tuple(arguments)
        listed = subprocess.check_output(
            ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"), cwd=ROOT
        )
        for name in filter(None, listed.decode().split("\0")):
            if (ROOT / name).is_file():
                (self._tree / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, self._tree / name)
        if (ROOT.parent / "shared").is_dir():
            (folder / "shared").symlink_to(ROOT.parent / "shared")
        # As tests/conftest.py has it, but before jax is imported: jax looks at them only then.
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_cache" / "jax"))
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
        self._forks = multiprocessing.get_context("forkserver")
        self._forks.set_forkserver_preload(list(PRELOADED))

    def first_failure(
        self, mutation: Mutation, known: Sequence[str]
    ) -> tuple[str | None, list[str]]:
        """The tier and the first test that notices a mutation, of those expected to: in `make
        test` if one is, else in what `make test-all` has beside it.

        `known` are those of an earlier run, tried before; they may be gone since."""
        with self._mutated(mutation):
            for tier, marks in _apart("all"):
                for tests in (known, mutation.tests):
                    if failed := self._failures(tests, marks, "-x"):
                        return tier, failed[:1]
        return None, []

    def failures(self, mutation: Mutation, tier: str) -> tuple[str | None, list[str]]:
        """The least tier that notices a mutation, and all tests up to this tier that do, the cases
        of each taken together."""
        least, every = None, set()
        with self._mutated(mutation):
            for at, marks in _apart(tier):
                failed = self._failures(("tests",), marks)
                least = least or (at if failed else None)
                every |= {test.partition("[")[0] for test in failed}
        return least, sorted(every)

    def failures_unmutated(self, tests: Sequence[str]) -> list[str]:
        """Which of these fail without any mutation."""
        return self._failures(tests, TIERS["all"])

    @contextmanager
    def _mutated(self, mutation: Mutation) -> Iterator[None]:
        try:
            self._write(mutation.path, mutation.applied())
            yield
        finally:
            self._write(mutation.path, (ROOT / mutation.path).read_text())

    def _write(self, path: Path, text: str) -> None:
        (self._tree / path).write_text(text)
        # Two texts of one size within a second look alike to Python's cache of compiled modules.
        shutil.rmtree((self._tree / path).parent / "__pycache__", ignore_errors=True)

    def _failures(self, tests: Sequence[str], marks: str, *options: str) -> list[str]:
        # Tests may be gone, or none of a file may have these marks.
        existing = [test for test in tests if (self._tree / test.partition("::")[0]).is_file()]
        if tests != ("tests",) and not existing:
            return []
        quiet = ("-n", "0", "-p", "no:cacheprovider", "--assert=plain", "--tb=line")
        command = (*quiet, *options, "-m", marks, *self._arguments, *(existing or tests))
        output, (ours, theirs) = self._folder / "output", self._forks.Pipe(duplex=False)
        fork = self._forks.Process(target=_pytest, args=(self._tree, output, command, theirs))
        fork.start()
        theirs.close()
        try:
            code, failed = ours.recv()
        except EOFError:
            return [DIED]
        finally:
            fork.kill()
            fork.join()
        is_gone = code == pytest.ExitCode.USAGE_ERROR and "not found: " in output.read_text()
        ended = (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
        if code not in ended and not failed and not is_gone:
            raise RuntimeError(f"pytest ended with {code}:\n{output.read_text()}")
        return failed


def _apart(tier: str) -> list[tuple[str, str]]:
    """The tiers up to this one, each with the marks of what it has beside those before it."""
    if tier == "test":
        return [("test", TIERS["test"])]
    return [("test", TIERS["test"]), ("all", f"({TIERS['all']}) and not ({TIERS['test']})")]


class _Failures:
    """A plugin of pytest: the tests that failed, and files that could not be collected."""

    def __init__(self):
        self.tests: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and report.nodeid not in self.tests:
            self.tests.append(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.tests.append(report.nodeid)


def _pytest(tree: Path, output: Path, command: Sequence[str], theirs: Connection) -> None:
    """In a fork: pytest in `tree`, its exit code and the tests that failed by `theirs`."""
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S))
    descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    os.chdir(tree)
    os.environ["PYTHONPATH"] = str(tree)  # for what tests start
    # Everything of the project comes from the copy.
    sys.path[:] = [str(tree), *(path for path in sys.path if path not in ("", str(ROOT)))]
    for name in [name for name in sys.modules if name.partition(".")[0] in ("tests", "srsinv")]:
        del sys.modules[name]
    failures = _Failures()
    code = pytest.main(list(command), plugins=[failures])
    theirs.send((int(code), failures.tests))
