"""Set-up of every test: srsinv comes before jax, so that double precision is on.

With `--types` srsinv comes under a hook that checks every shape and type annotation of the rooms
that hold arrays as they run, which makes tests a fifth slower. It stays for the whole session: it
works on each module of the package as that is imported.
"""

import gc
import os
import sys
from importlib.metadata import version
from pathlib import Path

# Two workers of as many threads each wait for one another: before numpy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from jaxtyping import install_import_hook

import tests.tower  # noqa: F401  looked up by its name
from srsinv.command.compilation_cache import machine_kind

# What Python translates one time serves the other processes too, of commands that tests run.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Compiling is most of the tests' time, and small sizes gain nothing from the last optimisations.
QUICK_TO_COMPILE = (
    "--xla_llvm_disable_expensive_passes=true",
    "--xla_cpu_parallel_codegen_split_count=1",
    "--xla_backend_optimization_level=0",
)
if version("jaxlib").startswith("0.10."):  # later ones end where they do not know a flag
    QUICK_TO_COMPILE += ("--xla_cpu_use_fusion_emitters=false",)
os.environ.setdefault("XLA_FLAGS", " ".join(QUICK_TO_COMPILE))
# What one worker, or an earlier run on such a machine, has compiled serves the others.
ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_cache" / "jax" / machine_kind())
)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")

ROOMS = ("grid", "forward", "inverse", "jobs", "recording")

import srsinv  # noqa: E402, F401
from srsinv.command.programs import RARE, release_programs  # noqa: E402
from tests.tiers import mark_single_precision  # noqa: E402

pytest_plugins = ["tests.seconds"]
MOST_MAPS = 15_000
# Rooms with the longest files: begun last, they would leave a worker idle.
LONGEST_FIRST = ("golden", "jobs", "stability", "inverse", "forward", "recording")


def pytest_addoption(parser):
    parser.addoption("--types", action="store_true", help="check annotations as they run")


def pytest_configure(config):
    if config.option.types:
        install_import_hook([f"srsinv.{room}" for room in ROOMS], "beartype.beartype")
        install_import_hook("srsinv.report", "tests.tower.checked")


def pytest_collection_finish():
    """Tracing makes many objects that live long: collected as often as by default they take a
    tenth of the tests' time."""
    gc.freeze()
    gc.set_threshold(*RARE)


@pytest.fixture(autouse=True, scope="module")
def few_programs():
    """Lets go of what was compiled before it is too much."""
    yield
    release_programs(MOST_MAPS)


def pytest_collection_modifyitems(items):
    mark_single_precision(items)
    items.sort(key=_turn)


def _turn(item: pytest.Item) -> int:
    room = item.path.relative_to(ROOT / "tests").parts[0]
    return (*LONGEST_FIRST, room).index(room)
