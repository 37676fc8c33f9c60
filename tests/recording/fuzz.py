"""Reads damaged copies of good files until it is told to stop: run as a process of its own, which a
library that crashes takes down alone.

python -m tests.recording.fuzz FORMAT FOLDER FIRST_SEED COPIES
"""

import random
import sys
from pathlib import Path

from srsinv.errors import BadInput
from srsinv.recording import load
from srsinv.recording.inspection import inspect
from tests.recording.files import FORMATS, write

EXTREMES = [b"\x00" * 8, b"\xff" * 8, b"\x7f" + b"\xff" * 7, b"\xff" * 7 + b"\x7f", b"\x80" * 4]


def damaged(good: bytes, chance: random.Random) -> bytes:
    """A copy with a few bytes flipped, set to extremes, cut off, left out, repeated or moved."""
    data = bytearray(good)
    for _ in range(chance.randint(1, 4)):
        at, other = (chance.randrange(len(data)) for _ in range(2))
        size = chance.choice((1, 4, 8, 64, 512))
        match chance.randrange(6):
            case 0:
                data[at] ^= 1 << chance.randrange(8)
            case 1:
                extreme = chance.choice(EXTREMES)
                data[at : at + len(extreme)] = extreme
            case 2 if chance.random() < 0.2:
                del data[at + 1 :]
            case 3:
                del data[at : at + size]
            case 4:
                data[at:at] = data[other : other + size]
            case _:
                data[at : at + size] = data[other : other + size]
        data = data or bytearray(b"x")
    return bytes(data)


def main(format: str, folder: Path, first: int, copies: int) -> None:
    """Print a line for every copy: its seed before it is read, then what became of it."""
    path = write(format, folder)
    good = path.read_bytes()
    known = {"speed_m_per_s": 0.05} if format == "wav" else {}
    for seed in range(first, first + copies):
        print(seed, end=" ", flush=True)
        path.write_bytes(damaged(good, random.Random(seed)))
        for read in (load, inspect):
            try:
                read(path, **known)
                print("read", end=" ")
            except BadInput as refusal:
                print("refused" if str(refusal).isprintable() else "unprintable", end=" ")
        print(flush=True)


if __name__ == "__main__":
    format, folder, first, copies = sys.argv[1:]
    assert format in FORMATS
    main(format, Path(folder), int(first), int(copies))
