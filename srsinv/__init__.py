"""srsinv: forward and inverse model of stress-rate tactile sensors.

Double precision is the default: stress decays as exp(-kz), so an inversion loses digits quickly.
The variable is set before jax is imported, so that `import srsinv` itself stays quick; a value that
the user has set in JAX_ENABLE_X64 is left as it is.
"""

import os
import sys

# `python -m srsinv` puts the current folder first on the import path, where a file named as one of
# the standard library's modules would be run in its place. Only then is the first argument "-m".
if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    del sys.path[0]

if "JAX_ENABLE_X64" not in os.environ:
    os.environ["JAX_ENABLE_X64"] = "true"
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)

from .errors import BadInput as BadInput

__version__ = "0.1.0"

_LAZY = ("fit", "fit_many", "Fit")  # with jax, which takes a second to import


def __getattr__(name: str):
    if name in _LAZY:
        from .inverse import nonlinear

        return getattr(nonlinear, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
