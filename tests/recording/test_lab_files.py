"""The lab files beside the project: one ridge as instruments and people write it.

Each is read as the scan that it holds, or refused, or read and doubted; inspection says the same.
"""

from contextlib import suppress

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.recording.even import load_even
from srsinv.recording.inspection import inspect
from tests.shared import SHARED, needs_shared

LAB_FILES = SHARED / "lab_files"
RATE_HZ, SPEED_M_PER_S, START_M = 2000.0, 0.02, -0.015
ALLOWED = {"missing": "allow"}
# file: settings to read it by, and samples that are then missing in any signal.
READ = {
    "channels_X_Y.csv": ({}, 0),
    "encoder_side_film.csv": ({}, 0),
    "encoder_wrap.csv": ({}, 0),
    "lvm_header.txt": ({}, 0),
    "micros_rollover.csv": ({}, 0),
    "overrange.csv": (ALLOWED, 1),
    "position_held.csv": ({}, 0),
    "scale_factor.h5": ({}, 0),
    "scope_rigol.csv": ({}, 0),
    "semicolon_preamble.csv": ({}, 0),
    "stage_late.tdms": ({}, 0),
    "temperature_T.csv": ({}, 0),
    "nan_words.csv": (ALLOWED, 1),
}
REFUSED = ("constant.csv", "three_rows.csv", "thousands_counts.csv")
DOUBTED = ("header_unit_lies.csv", "encoder_wrap.csv")


def scan():
    """The signals (channel, sample) [V] at 20 mm/s and 2 kHz, after their gains."""
    return load_even({"path": str(LAB_FILES / "semicolon_preamble.csv")}, {})


@needs_shared
@pytest.mark.parametrize("name", READ)
def test_a_file_is_read_as_the_scan_that_it_holds(name):
    known, missing = READ[name]
    truth, read = scan(), load_even({"path": str(LAB_FILES / name), **known}, {})
    late = truth.time_s.size - read.time_s.size if name == "stage_late.tdms" else 0
    kept = slice(late // 2, truth.time_s.size - late // 2)
    seen = np.isfinite(read.signal)
    assert bool((~seen).any()) == bool(missing)
    digit = 6e-7 if name == "scale_factor.h5" else 2e-8  # of a count, over the gain
    np.testing.assert_allclose(read.signal[seen], truth.signal[:, kept][seen], atol=digit)
    np.testing.assert_allclose(read.speed_m_per_s, SPEED_M_PER_S, rtol=2e-3)
    start_m = 0.015 if name == "encoder_wrap.csv" else truth.position_m[kept][0]
    moved_m = truth.position_m[kept] - truth.position_m[kept][0]
    np.testing.assert_allclose(read.position_m - start_m, moved_m, atol=1e-5)
    assert bool(read.doubts) == (name in DOUBTED)


@needs_shared
@pytest.mark.parametrize("name", [*READ, *REFUSED, *DOUBTED])
def test_inspection_and_reading_agree(name):
    """What the inspection calls usable as it is is read without more, and without a doubt."""
    path = LAB_FILES / name
    read = outcome(lambda: load_even({"path": str(path)}, {}))
    found = outcome(lambda: inspect(path))
    assert (read is None) == (name in (*REFUSED, "overrange.csv", "nan_words.csv"))
    if found is not None:  # else the table itself is refused, by both
        assert (found.refusal is None) == (read is not None)
        assert found.doubts == (read.doubts if read else ())
    else:
        assert read is None


def outcome(look):
    """What is found, or None where it is refused."""
    with suppress(BadInput):
        return look()
