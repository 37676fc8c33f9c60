"""Runs tests on a copy of the tree with one mutation at a time: does a test notice it?"""

import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from .table import ROOT, Mutation

# The tests of `make test`, and what `make test-all` has beside them.
TIERS = {"test": "not full and not claim", "all": "full and not claim"}
LONGEST_S = 600  # of processor time: a mutation may well make a search endless
DIED = "pytest died"  # in place of a test: of an endless search, or of what ends Python itself


class Copy:
    """A copy of the working tree, in which one mutation at a time is made and taken back."""

    def __init__(self, folder: Path):
        self._tree, self._cache = folder / "tree", folder / "cache"
        listed = subprocess.check_output(
            ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"), cwd=ROOT
        )
        for name in filter(None, listed.decode().split("\0")):
            if (ROOT / name).is_file():
                (self._tree / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, self._tree / name)
        # What tests have compiled in the clone serves the copy.
        (ROOT / ".pytest_cache").mkdir(exist_ok=True)
        (self._tree / ".pytest_cache").symlink_to(ROOT / ".pytest_cache")

    def noticed(self, mutation: Mutation, known: str | None) -> tuple[str | None, str | None]:
        """The tier and the first test that notices a mutation, of those expected to: `known`, which
        did in an earlier run, else one of `make test`, else one of `make test-all`."""
        with self._mutated(mutation):
            for tests in ([known] if known else [], mutation.tests):
                for tier in TIERS:
                    if failed := self.failed(tests, tier):
                        return tier, failed[0]
        return None, None

    def failed(self, tests: Sequence[str], tier: str, *options: str) -> list[str]:
        """The first of these tests that fails, or nothing."""
        # A test that noticed a mutation once may be gone.
        tests = [test for test in tests if (self._tree / test.partition("::")[0]).is_file()]
        if not tests:
            return []
        shutil.rmtree(self._cache, ignore_errors=True)
        ran = subprocess.run(
            (sys.executable, "-m", "pytest", "-x", "-n", "0", "--assert=plain", "--tb=line",
             "-o", f"cache_dir={self._cache}", "-m", TIERS[tier], *options, *tests),
            cwd=self._tree,
            env=os.environ | {"PYTHONPATH": str(self._tree)},
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S)),
            capture_output=True,
            text=True,
        )  # fmt: skip
        last = self._cache / "v" / "cache" / "lastfailed"
        if ran.returncode < 0:
            return [DIED]
        if last.is_file():
            return list(json.loads(last.read_text()))
        # None failed, none has these marks, or one that was known is gone.
        if ran.returncode in (0, 5) or "not found: " in ran.stderr:
            return []
        raise RuntimeError(f"pytest ended with {ran.returncode}:\n{ran.stdout}{ran.stderr}")

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
