"""The one way to a file's bytes."""

from pathlib import Path

from srsinv.errors import BadInput


def read_bytes(path: Path, *, what: str, most: int) -> bytes:
    """The content of `path`, which a refusal calls `what`. Raises `BadInput`."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadInput(
            f"{path}: this {what} cannot be read ({error.strerror}): check recording.{what}=..."
        ) from error
