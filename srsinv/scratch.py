"""Scratch files and folders: they carry their process's number, so that what a killed one left can
be told from what a living one still writes."""

import os


def abandoned(process: str) -> bool:
    """Whether no process of this number (digits) runs any more; False where that is not known."""
    if os.name != "posix" or not (process.isascii() and process.isdecimal()):
        return False
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):
        return False
    return False
