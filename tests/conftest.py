"""Set-up of every test: srsinv comes before jax, so that double precision is on, and under a hook
that checks every shape and type annotation of the rooms that hold arrays as they run.

The hook stays for the whole session: it works on each module of the package as that is imported.
"""

import os

from jaxtyping import install_import_hook

# Compiling is most of the tests' time, and small sizes gain nothing from the last optimisations.
os.environ.setdefault("XLA_FLAGS", "--xla_llvm_disable_expensive_passes=true")

ROOMS = ("grid", "forward", "inverse", "jobs", "recording", "report.figures")
install_import_hook([f"srsinv.{room}" for room in ROOMS], "beartype.beartype")

import srsinv  # noqa: E402, F401
