"""Reading of a file in a separate process, which isolates crashes and endless loops.

HDF5's library does either on damaged bytes (in version 2.0, on one in a few hundred damaged chunked
files). A server is started with the first such file and ends with its caller. It forks for every
file, which costs milliseconds and is safe where the caller, with jax, is not: it is small and has
one thread. Where a system cannot fork, the file is read in the caller's process.
"""

import abc
import atexit
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterable
from io import BufferedReader, BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np

from srsinv.errors import BadInput

from ..files import DataFile
from ._table import ColumnTable
from .reader import Reader

_SECONDS = 5  # of computing that a small file may take
_BYTES_PER_SECOND = 3 * 10**6  # and how many more bytes a further second: chunks of one value
_MOST_SECONDS = 60  # of computing that any file may take
_PATIENCE = 20  # times longer that it may take on a busy machine
_MEMORY = 2**32  # bytes: the limits on what a file may hold leave a factor of four
_MESSAGE = 2**16  # bytes that ask for a file, of which its name is at most 255
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from srsinv.recording import _apart, formats; "
    "_apart.serve(int(sys.argv[2]), formats.SUFFIXES.values())"
)
_ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL")}


class IsolatedReader(Reader):
    """A reader of the package that reads every file in a process of its own."""

    @abc.abstractmethod
    def read_here(self, file: DataFile) -> ColumnTable:
        """The table in a file, read in this process."""

    def read(self, file: DataFile) -> ColumnTable:
        """Raises `BadInput` and `MemoryError` as `read_here` does, and `EOFError` for all else."""
        if not hasattr(socket, "send_fds") or not sys.executable:
            return self.read_here(file)
        with _SERVER.lock:
            receiving, sending = os.pipe()
            with open(receiving, "rb") as answer:
                try:
                    _SERVER.ask(file, type(self), sending)
                finally:
                    os.close(sending)
                return _table(answer)


def _table(answer: BufferedReader) -> ColumnTable:
    said = answer.readline()
    if not said.endswith(b"\n"):
        raise EOFError("the process that read it ended")
    header = json.loads(said)
    if "refused" in header:
        raise BadInput(header["refused"])
    if "memory" in header:
        raise MemoryError
    columns, units = header.pop("columns"), header.pop("units")
    table = ColumnTable(**header)
    for name, kind, size in columns:
        values = np.empty(size, kind)

        def filled(values: np.ndarray = values) -> np.ndarray:
            if answer.readinto(values.view(np.uint8).data) != values.nbytes:
                raise EOFError("the process that read it ended")
            return values

        table.take(name, values.shape, values.dtype, filled, units.get(name))
    return table


class _Server:
    """The process that forks for every file, started when it is first asked."""

    def __init__(self):
        self.lock = threading.Lock()
        self._process: subprocess.Popen | None = None
        self._socket: socket.socket | None = None
        self._owner = 0

    def ask(self, file: DataFile, reader: type[IsolatedReader], sending: int) -> None:
        """Ask for the file to be read and its table written to descriptor `sending`."""
        if self._process is None or self._process.poll() is not None or self._owner != os.getpid():
            self._start()
        assert self._socket is not None
        message = json.dumps([file.path.name, reader.__name__]).encode()
        socket.send_fds(self._socket, [message], [file.fileno(), sending])

    def _start(self) -> None:
        self.stop()
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        path = [each for each in sys.path if os.path.isabs(each)]
        command = [sys.executable, "-I", "-c", _START, json.dumps(path), str(theirs.fileno())]
        nowhere = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
        with theirs:
            self._process = subprocess.Popen(
                command,
                pass_fds=[theirs.fileno()],
                start_new_session=True,  # Ctrl-C is the caller's
                env={**os.environ, **_ONE_THREAD},
                **nowhere,
            )
        self._owner = os.getpid()

    def stop(self) -> None:
        """Close the socket, on which the server ends, and wait for it if it is this process's
        own."""
        if self._socket is not None:
            self._socket.close()
        if self._process is not None and self._owner == os.getpid():
            self._process.wait()
        self._process = self._socket = None


_SERVER = _Server()
atexit.register(_SERVER.stop)


def serve(descriptor: int, readers_known: Iterable[Reader]) -> None:
    """Read, each in a process of its own, the files that are asked for, until no process can
    ask; `readers_known`: those that it may be asked to read by."""
    readers = {type(each).__name__: each for each in readers_known}
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # ended children are not waited for
    with socket.socket(fileno=descriptor) as asked:
        while True:
            message, descriptors, *_ = socket.recv_fds(asked, _MESSAGE, 2)
            if not message:
                return
            if os.fork() == 0:
                asked.close()
                try:
                    source, sending = descriptors
                    name, reader = json.loads(message)
                    _read(name, readers[reader], source, sending)
                finally:
                    os._exit(0)
            for each in descriptors:
                os.close(each)


def _read(name: str, reader: Any, source: int, sending: int) -> None:
    with open(sending, "wb") as answer, DataFile(source, Path(name)) as file:
        _limit(file.size)
        file.seek(0)
        try:
            table = reader.read_here(file)
        except BadInput as refusal:
            _say(answer, {"refused": str(refusal)})
        except MemoryError:
            _say(answer, {"memory": True})
        else:
            parts = {key: value for key, value in vars(table).items() if key != "columns"}
            kinds = [(name, each.dtype.str, each.size) for name, each in table.columns.items()]
            _say(answer, {**parts, "columns": kinds})
            for values in table.columns.values():
                answer.write(np.ascontiguousarray(values).view(np.uint8).data)


def _say(answer: BufferedWriter, what: dict[str, Any]) -> None:
    answer.write(json.dumps(what).encode() + b"\n")


def _limit(size: int) -> None:
    """Let the system end this process where it takes too long or too much memory."""
    import resource  # which not every system has

    seconds = min(_SECONDS + size // _BYTES_PER_SECOND, _MOST_SECONDS)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.alarm(_PATIENCE * seconds)
    used = Path("/proc/self/statm")
    if used.exists():
        pages = int(used.read_text().split()[0])
        most = pages * resource.getpagesize() + _MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
