"""Recordings of measured signals, read from files and written to them (without jax)."""

from ._read import check_settings as check_settings
from ._read import facts_of as facts_of
from ._read import load as load
from ._recording import Recording as Recording
from ._sidecar import MOST_BYTES as MOST_OF_SIDECAR  # noqa: F401
from ._sidecar import SUFFIXES as SIDECAR_SUFFIXES  # noqa: F401
from ._sidecar import merge as merge
from ._write import save as save
from .flat_columns import load_profile as load_profile
from .reader import Reader as Reader
