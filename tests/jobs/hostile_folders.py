"""Folders of runs as nobody's srsinv leaves them, each by the function that makes it."""

import json
import os
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from srsinv.run_folder import FAILURES, MANIFEST, RunRecord, listing, manifest

ESCAPES = "\x1b[31m\x9b\u202e\u2028"
FIELDS = ("job", "jobs", "setting", "status", "reason", "shown", "metric_shown", "jobs_failed")
Make = Callable[[Path], object]


def a_run(folder: Path, metrics: Any, command: str = "srsinv a=1", arrays: Make | None = None):
    """A run's folder whose manifest is right; `metrics` as a value, or as the file's bytes."""
    folder.mkdir(parents=True)
    text = metrics if isinstance(metrics, bytes) else json.dumps(metrics).encode()
    (folder / "metrics.json").write_bytes(text)
    (folder / MANIFEST).write_bytes(
        manifest(listing({"metrics.json": text}), RunRecord(command, 0))
    )
    if arrays is not None:
        arrays(folder / "result.nc")


def run(metrics: Any, **more: Any) -> Make:
    return lambda folder: a_run(folder / "x", metrics, **more)


def instead(name: str, put: Make) -> Make:
    """A run, one of whose files is something else."""

    def make(folder: Path) -> None:
        a_run(folder / "x", {"m": 1.0})
        (folder / name).unlink(missing_ok=True)
        put(folder / name)

    return make


def link(to: str) -> Make:
    return lambda path: path.symlink_to(to)


def listening(path: Path) -> None:
    before = os.getcwd()
    os.chdir(path.parent)  # as a socket's path is short
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(before)


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(5 * 2**30)


def arrays(pattern: Any, unit: Any = "Pa", shape: tuple[int, ...] = ()) -> Make:
    def make(path: Path) -> None:
        with h5py.File(path, "w") as file:
            file.create_dataset("v", shape, "f8").attrs.update({"metric": pattern, "units": unit})

    return make


def links(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["e"], file["s"] = h5py.ExternalLink("/dev/zero", "/x"), h5py.SoftLink("/s")
        file.create_dataset("x", (3,), "f8", external=[("/etc/passwd", 0, 24)])
        file.create_dataset("t", (3,), h5py.ref_dtype).attrs["metric"] = file.ref


def cut(path: Path) -> None:
    arrays("m")(path)
    os.truncate(path, path.stat().st_size // 2)


def failures(document: Any) -> Make:
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    return lambda folder: (folder / FAILURES).write_bytes(text)


def named(*names: bytes) -> Make:
    def make(folder: Path) -> None:
        for name in names:
            a_run(Path(os.fsdecode(os.fsencode(folder) + b"/" + name)), {"m": 1.0})

    return make


def nested(folder: Path) -> None:
    place = folder
    for _ in range(200):
        place /= "d"
    a_run(place, {"m": 1.0})


def manifest_of(text: bytes) -> Make:
    return instead(f"x/{MANIFEST}", lambda path: path.write_bytes(text))


def written(**content: Any) -> bytes:
    whole = {"command": "srsinv", "files": {}, "seed": 0, "version": "1"} | content
    return f"{json.dumps(whole, sort_keys=True, indent=2)}\n".encode()


KINDS: Mapping[str, Make] = {
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "a socket": listening,
    "an endless device": link("/dev/zero"),
    "a terminal": link("/dev/tty"),
    "the kernel's messages": link("/proc/kmsg"),
    "a link to another's": link("/etc/passwd"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "5 GB": sparse,
    "nothing": Path.touch,
    "noise": lambda path: path.write_bytes(bytes(range(256)) * 40),
}
PLACES = (f"x/{MANIFEST}", "x/result.nc", FAILURES)
FOLDERS: Mapping[str, Make] = {
    **{f"{kind} as metrics": instead("x/metrics.json", put) for kind, put in KINDS.items()},
    **{f"{kind} as {name}": instead(name, KINDS[kind])
       for kind in ("a pipe", "an endless device", "noise") for name in PLACES},
    # metrics.json
    "escapes in a name": run({f"m{ESCAPES}": 1.0}),
    "escapes in a word": run({"m": ESCAPES}),
    "half a character": run(b'{"m\\ud800": 1}'),
    "a zero byte in a name": run({"m\0": 1}),
    "a zero byte at the end": run(b'{"m": 1}\0'),
    "a mark of byte order": run(b'\xef\xbb\xbf{"m": 1}'),
    "UTF-16": run('{"m": 1}'.encode("utf-16")),
    "a name twice": run(b'{"m": 1, "m": 2}'),
    "deep": run(b'{"a":' * 5000 + b"1" + b"}" * 5000),
    "a hundred deep": run(b'{"a":' * 100 + b"1" + b"}" * 100),
    "an integer of 5,000 digits": run(b'{"m": ' + b"9" * 5000 + b"}"),
    "an integer of 4,000 digits": run(b'{"m": ' + b"9" * 4000 + b"}"),
    "beyond all sums": run({"m": 1e308}),
    "beyond all numbers": run(b'{"m": 1e999}'),
    "no number": run(b'{"m": NaN}'),
    "a list": run([1, 2]),
    "one number": run(1),
    "names of no letters": run({"": 1, " ": 1, ".": 1, "..": 2, "/": 1}),
    "many names": run({f"n{i}": i for i in range(20_000)}),
    "many values": run({"n": list(range(20_000))}),
    "code in names": run({"{m!s:>4000000000}": 1.0, "{{ 7*7 }}": 3, "<script>": 4, "$x_$": 5}),
    **{f"a metric {each}": run({each: 1.0}, command=f"srsinv {each}=3") for each in FIELDS},
    **{f"a word {each}": run({each: "w"}, command=f"srsinv {each}=w") for each in FIELDS},
    # run.json
    "no mapping": manifest_of(b"[]\n"),
    "a deep manifest": manifest_of(b'{"a":' * 5000),
    "a command of a number": manifest_of(written(command=5)),
    "a command of a list": manifest_of(written(command=["a"])),
    "a quotation mark": run({"m": 1}, command='srsinv "a=1'),
    "a long command": run({"m": 1}, command="srsinv b=" + "x" * 2_000_000),
    "escapes in an override": run({"m": 1}, command=f"srsinv 'b={ESCAPES}' 'c{ESCAPES}=1'"),
    "code in an override": run({"m": 1}, command="srsinv 'b={{ 7 }}{% for %}$x_{$' 'c$a=1'"),
    "numbers beyond plots": run({"m": 1}, command="srsinv b=1e999 c=nan d=1e308 e=-1e308"),
    # result.nc
    "a long format": run({"m": 1}, arrays=arrays("{m!s:>4000000000}")),
    "a format of attributes": run({"m": 1}, arrays=arrays("{m.__class__}")),
    "many braces": run({"m": 1}, arrays=arrays("{" * 10_000)),
    "many fields": run({"m" * 200: 1}, arrays=arrays("{a}m{b}m{c}m{d}m{e}m{f}m{g}m{h}!")),
    "a pattern of a number": run({"m": 1}, arrays=arrays(5)),
    "escapes in a unit": run({"m": 1}, arrays=arrays("m", ESCAPES)),
    "a long unit": run({"m": 1}, arrays=arrays("m", "u" * 60_000)),
    "a unit of numbers": run({"m": 1}, arrays=arrays("m", np.zeros(9))),
    "values never written": run({"m": 1}, arrays=arrays("m", shape=(4 * 10**8,))),
    "links": run({"m": 1}, arrays=links),
    "cut short": run({"m": 1}, arrays=cut),
    # failures.json
    "failures, a list": failures([]),
    "failures, no mapping": failures({"1": 1}),
    "failures, no reason": failures({"1": {"reason": 5, "overrides": []}}),
    "failures, no number": failures({ESCAPES: {"reason": "r", "overrides": []}}),
    "failures, 5,000 digits": failures({"9" * 5000: {"reason": "r", "overrides": []}}),
    "failures, deep": failures(b'{"a":' * 100_000),
    "failures, no text": failures(b"\xff\xfe"),
    "failures, escapes": failures({"1": {"reason": ESCAPES, "overrides": [f"b={ESCAPES}"]}}),
    "failures, long": failures({"1": {"reason": "x" * 10**6, "overrides": ["b=\n\n# h"]}}),
    # The folder itself
    "names of folders": named(b"\x1b[31m", b"a\nb", "\u202e".encode(), b"-rf", b"\xff", b"a" * 255),
    "a link to all": lambda folder: (folder / "all").symlink_to("/"),
    "a link to its own": lambda folder: (folder / "own").symlink_to(folder),
    "200 folders deep": nested,
}  # fmt: skip
