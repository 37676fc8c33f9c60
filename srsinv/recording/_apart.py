"""Reading of a file in a separate process, which isolates crashes and endless loops.

HDF5's library does either on damaged bytes (in version 2.0, on one in a few hundred damaged chunked
files). A server is started with the first such file and ends with its caller. It forks for every
file, which costs milliseconds and is safe where the caller, with jax, is not: it is small and has
one thread. It says how the forked process ended, as a damaged file, a scheduler and a lack of
memory each have a remedy of their own. Where a system cannot fork, the file is read in the caller's
process.
"""

import abc
import atexit
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
from contextlib import suppress
from io import BufferedReader, BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np

from srsinv.errors import BadInput

from ..files import DataFile, quoted
from ._stated import Clock
from ._table import ColumnTable, most_unpacked
from .reader import Reader

_SECONDS = 5  # of computing that a small file may take
_BYTES_PER_SECOND = 3 * 10**6  # and how many more bytes a further second: chunks of one value
_MOST_SECONDS = 60  # of computing that any file may take
_PATIENCE = 20  # times longer that it may take on a busy machine
_MEMORY = 2**29  # bytes that a reader may take
_COPIES = 4  # of all values, that it may take beside these
_MESSAGE = 2**16  # bytes that ask for a file, of which its name is at most 255
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from srsinv.recording import _apart; "
    "_apart.serve(int(sys.argv[2]))"
)
_ENDED = struct.Struct("=i")  # how a process ended, as `os.waitpid` has it
_NO_FORK = -1
_TOO_LONG = (getattr(signal, "SIGXCPU", None), getattr(signal, "SIGALRM", None))
_OTHERWISE = "save the recording as .csv or .npz"
_ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL")}


class IsolatedReader(Reader):
    """A reader of the package that reads every file in a process of its own."""

    @abc.abstractmethod
    def read_here(self, file: DataFile) -> ColumnTable:
        """The table in a file, read in this process."""

    def read(self, file: DataFile) -> ColumnTable:
        """Raises `BadInput` and `MemoryError` as `read_here` does, `BadInput` where the process
        cannot do its work, whatever the file, and `EOFError` for all else."""
        if not hasattr(socket, "send_fds") or not sys.executable:
            return self.read_here(file)
        with _SERVER.lock:
            return _SERVER.table(file, type(self))


def _table(answer: BufferedReader) -> ColumnTable | None:
    """The table that a process wrote, or None where it ended before."""
    said = answer.readline()
    if not said.endswith(b"\n"):
        return None
    header = json.loads(said)
    if "refused" in header:
        raise BadInput(header["refused"])
    if "memory" in header:
        raise MemoryError
    columns, units = header.pop("columns"), header.pop("units")
    left_out = {name: units[name] for name in header["unusable"] if name in units}
    clocks = {name: Clock(*times) for name, times in header.pop("clocks").items()}
    table = ColumnTable(**header, clocks=clocks, units=left_out)
    for name, kind, size in columns:

        def filled(kind: str = kind, size: int = size) -> np.ndarray:
            values = np.empty(size, kind)
            if answer.readinto(values.view(np.uint8).data) != values.nbytes:
                raise EOFError("the process that read it ended")
            return values

        table.take(name, (size,), np.dtype(kind), filled, {"units": units.get(name)})
    return table


def _refuse_end(name: str, status: int | None) -> None:
    """Refuse what a process that read a file ended by, unless it is the file's own fault."""
    ended = None if status is None or status < 0 else os.waitstatus_to_exitcode(status)
    if status is None or status == _NO_FORK:
        raise BadInput(
            f"{name}: the process that reads it cannot be started: allow more memory and "
            f"processes, as by ulimit -v and ulimit -u, or {_OTHERWISE}."
        )
    if ended == -signal.SIGKILL:
        raise BadInput(
            f"{name}: the process that read it was killed: allow more memory, or {_OTHERWISE}."
        )
    if ended is not None and -ended in _TOO_LONG:
        raise BadInput(
            f"{name}: reading takes longer than a file of this size may: check that it is "
            "not damaged, and write it again in larger chunks."
        )


class _Server:
    """The process that forks for every file, started when it is first asked."""

    def __init__(self):
        self.lock = threading.Lock()
        self._process: subprocess.Popen | None = None
        self._socket: socket.socket | None = None
        self._owner = 0

    def table(self, file: DataFile, reader: type[IsolatedReader]) -> ColumnTable:
        """The table in the file, by a reader in a process of its own."""
        name = quoted(file.path.name)
        try:
            answer = self._asked(file, reader)
        except OSError:
            self.stop()
            _refuse_end(name, None)
            raise
        table, ended = None, None
        try:
            try:
                with answer:
                    table = _table(answer)
            finally:  # closed, on which the process ends if it has not
                ended = self._ended()
        except (BadInput, MemoryError):
            raise
        except BaseException:  # as Ctrl-C
            self.stop()
            raise
        if table is None:
            _refuse_end(name, ended)
            raise EOFError("the process that read it ended")
        return table

    def _asked(self, file: DataFile, reader: type[IsolatedReader]) -> BufferedReader:
        """The answer to come to a request for the file's table."""
        if self._process is None or self._process.poll() is not None or self._owner != os.getpid():
            self._start()
        assert self._socket is not None
        format_name = f"{reader.__module__.rpartition('.')[2]}.{reader.__name__}"
        message = json.dumps([file.path.name, format_name]).encode()
        receiving, sending = os.pipe()
        try:
            socket.send_fds(self._socket, [message], [file.fileno(), sending])
        except OSError:
            os.close(receiving)
            raise
        finally:
            os.close(sending)
        return open(receiving, "rb")

    def _ended(self) -> int | None:
        """How the process that read the last file ended; None where the server has ended, too."""
        assert self._socket is not None
        with suppress(OSError, struct.error):
            return _ENDED.unpack(self._socket.recv(_ENDED.size))[0]
        return None

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
        """Close the socket, on which the server ends, and end it with what it is at, if it is this
        process's own."""
        if self._socket is not None:
            self._socket.close()
        if self._process is not None and self._owner == os.getpid():
            if self._process.poll() is None:
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._process = self._socket = None


_SERVER = _Server()
atexit.register(_SERVER.stop)


def serve(descriptor: int) -> None:
    """Read, each in a process of its own, the files that are asked for by a format of the package,
    until no process can ask."""
    from .formats import reader_of  # whose modules import this one

    with socket.socket(fileno=descriptor) as asked:
        while True:
            message, descriptors, *_ = socket.recv_fds(asked, _MESSAGE, 2)
            if not message:
                return
            source, sending = descriptors
            name, format_name = json.loads(message)
            reader = reader_of(format_name)  # here, so that the next file finds it imported
            try:
                process = os.fork()
            except OSError:
                process = _NO_FORK
            if process == 0:
                code = 1
                try:
                    asked.close()
                    _read(name, reader, source, sending)
                    code = 0
                finally:
                    os._exit(code)
            for each in descriptors:
                os.close(each)
            ended = _NO_FORK if process == _NO_FORK else os.waitpid(process, 0)[1]
            asked.sendall(_ENDED.pack(ended))


def _read(name: str, reader: Any, source: int, sending: int) -> None:
    with open(sending, "wb") as answer, DataFile(source, Path(name)) as file:
        _limit(file.size)
        file.seek(0)
        try:
            table = reader.read_here(file)
        except BadInput as refusal:
            _say(answer, {"refused": str(refusal)})
        except Exception as error:
            # HDF5 says in words alone that there is no memory.
            if not isinstance(error, MemoryError) and "alloc" not in str(error):
                raise
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
    """Let the system end this process where it takes too long or too much memory, and sooner where
    it has limits of its own, which only a privileged process may raise."""
    import resource  # which not every system has

    def lower(kind: int, soft: int, hard: int) -> None:
        own = resource.getrlimit(kind)[1]
        most = hard if own == resource.RLIM_INFINITY else min(own, hard)
        resource.setrlimit(kind, (min(soft, most), most))

    seconds = min(_SECONDS + size // _BYTES_PER_SECOND, _MOST_SECONDS)
    lower(resource.RLIMIT_CPU, seconds, seconds + 1)
    lower(resource.RLIMIT_CORE, 0, 0)
    signal.alarm(_PATIENCE * seconds)
    used = Path("/proc/self/statm")
    if used.exists():
        pages = int(used.read_text().split()[0])
        most = pages * resource.getpagesize() + _MEMORY + _COPIES * most_unpacked(size)
        lower(resource.RLIMIT_AS, most, most)
