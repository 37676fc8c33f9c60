"""A process that tries to read harmful files, each in a process forked from it.

python -m tests.recording.reading FOLDER CASE ... prints, for each case, what `load` and `inspect`
said, the seconds that both took and by how much the peak of the memory grew.
"""

import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.recording._apart import IsolatedReader
from srsinv.recording.inspection import inspect
from tests.recording.bad import HARMFUL, LARGE
from tests.recording.files import COLUMNS, write_csv


def in_a_process(work: Callable[[], object]) -> int:
    """The status of a process that does this and ends, or that the alarm ends."""
    process = os.fork()
    if process == 0:
        signal.alarm(60)
        work()
        sys.stdout.flush()
        os._exit(0)
    return os.waitpid(process, 0)[1]


def read_twice(case: str, path: Path) -> None:
    """Load and inspect, and print what came of it."""
    known = {"speed_m_per_s": 1.0} if path.suffix == ".wav" else {}
    before, said, start = peak_MB(), [], time.perf_counter()
    for read in (load, inspect):
        try:
            read(path, **known)
            said.append("read")
        except BadInput as refusal:
            said.append(str(refusal))
    took_s = time.perf_counter() - start
    print(json.dumps({"case": case, "said": said, "s": took_s, "MB": peak_MB() - before}))


def peak_MB() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(folder: Path, cases: list[str]) -> None:
    # The limits hold by themselves, without the process that would take a crash upon itself.
    IsolatedReader.read = lambda self, file: self.read_here(file)
    write_csv(folder / "warm.csv", COLUMNS)
    load(folder / "warm.csv")
    for number, case in enumerate(cases):
        bad = (HARMFUL | LARGE)[case]
        (folder / str(number)).mkdir()
        path = folder / str(number) / bad.file
        in_a_process(lambda make=bad.make, path=path: make(path))
        in_a_process(lambda case=case, path=path: read_twice(case, path))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
