"""The one command: `srsinv experiment=NAME key=value ...`, in Hydra's grammar.

Exit codes: 0 done, 1 a fault of the program (with its traceback), 2 an input that cannot be used
(one sentence on standard error, no files left), 130, 143 or 129 stopped by SIGINT, SIGTERM or
SIGHUP (the same).
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from .command.interrupts import stoppable
from .command.outcome import DONE, say
from .command.programs import rare_collections
from .command.surroundings import (
    check_current_folder,
    check_memory,
    printing,
    settle_drawing,
    settle_heaps,
    settle_streams,
    too_little_memory,
)
from .errors import BadInput

_PACKAGE = Path(__file__).resolve().parent


def find_config_root() -> Path:
    """The configurations: inside an installed wheel, or beside the package in a clone."""
    for folder in (_PACKAGE / "configs", _PACKAGE.parent / "configs"):
        if (folder / "config.yaml").is_file():
            return folder
    raise FileNotFoundError(f"no configs/config.yaml in or beside {_PACKAGE}")


@stoppable
def main(argv: Sequence[str] | None = None, config_root: Path | None = None) -> int:
    """Run the command on `argv` (default: the process's own) and return its exit code.

    `config_root` is the folder that holds `config.yaml`; its sibling `experiments`, where there is
    one, is made importable.
    """
    settle_streams(are_own=argv is None)
    if argv is None:  # else the process is another program's
        settle_heaps()
    try:
        arguments = list(sys.argv[1:] if argv is None else argv)
        with rare_collections(is_whole_process=argv is None):
            return _run(arguments, config_root or find_config_root())
    except BadInput as refusal:
        return say(refusal)
    except Exception as error:
        if refusal := too_little_memory(error):
            return say(refusal)
        raise


def _run(arguments: list[str], root: Path) -> int:
    if "--version" in arguments:
        from . import __version__

        with printing():
            print(f"srsinv {__version__}")
        return DONE
    if {"-h", "--help"} & set(arguments):
        from .command.help import help_text

        with printing():
            print(help_text(root), end="")
        return DONE

    settle_drawing()
    check_current_folder()
    check_memory()
    # Before numpy: its library's threads wait for each other longer than small matrices take.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from .command.launch import launch

    return launch(arguments, root)


if __name__ == "__main__":
    sys.exit(main())
