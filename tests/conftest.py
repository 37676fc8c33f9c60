"""Set-up of every test: srsinv comes before jax, so that double precision is on, and under a hook
that checks every shape and type annotation of the package as it runs.

The hook stays for the whole session: it works on each module of the package as that is imported.
"""

from jaxtyping import install_import_hook

install_import_hook("srsinv", "beartype.beartype")

import srsinv  # noqa: E402, F401
