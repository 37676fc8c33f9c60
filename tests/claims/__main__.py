"""The long studies, one after the other: `python -m tests.claims [NAME ...]`, all without a name.

Each is a module of this folder with a function `main`, and writes `results/NAME.json`. Those that
take long go on from what that file holds: delete it to run them anew. README is written at the end.
"""

import ast
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def studies() -> list[str]:
    """The modules that define `main`, but for this one."""
    return sorted(
        path.stem
        for path in HERE.glob("*.py")
        if path != Path(__file__)
        and any(getattr(node, "name", "") == "main" for node in ast.parse(path.read_text()).body)
    )


def main(names: list[str]) -> None:
    unknown = sorted(set(names) - set(studies()))
    if unknown:
        raise SystemExit(
            f"There is no study {', '.join(unknown)}; there are {', '.join(studies())}."
        )
    for name in names or studies():
        print(f"{name} ...", flush=True)
        subprocess.run([sys.executable, "-m", f"tests.claims.{name}"], check=True)
    subprocess.run([sys.executable, "-m", "tests.claims.readme"], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
