"""The rigs of raw_rigs.py: how they are, what is stated of them, and how their loggers write."""

from collections.abc import Sequence
from typing import Any

from tests.claims.raw_files import EDGE_M, FILM, Format, Rig


def stated(
    depth_m: float = 1.2e-3,
    angles_deg: Sequence[float] = (0.0, 45.0),
    offsets_m: Sequence[float] = (0.0, 1.5e-3),
    **more: Any,
) -> dict[str, Any]:
    """What a laboratory knows of its rig, roughly: angles and offsets of its strips."""
    elements = [
        {**FILM, "angle_deg": angle, "offset_m": offset}
        for angle, offset in zip(angles_deg, offsets_m, strict=False)
    ]
    return {
        "depth_m": depth_m, "feedback_resistance_ohm": 1e6, "strips": 2, "elements": elements,
        "nominal_pressure_Pa": 2e4, "feature": {"edge_length_m": EDGE_M},
        "skin": {"youngs_modulus_Pa": 7e5, "poisson_ratio": 0.5}, **more,
    }  # fmt: skip


def columns(time: Any, first: Any, second: Any, motion: Any, *more: Any, **form: Any) -> Format:
    """A format of columns (header, unit, digits)."""
    named = ("time", *time), (1, *first), (2, *second)
    return Format((*named, motion, *((0, *each) for each in more)), **form)


CM = columns(
    ("Time (s)", "s", 4), ("CH1 (mV)", "mV", 3), ("CH2 (mV)", "mV", 3),
    ("position", "Position [cm]", "cm", 5), separator=";", decimal=",",
)  # fmt: skip
GERMAN = columns(
    ("Zeit [s]", "s", 4), ("Kanal 1 [mV]", "mV", 3), ("Kanal 2 [mV]", "mV", 3),
    ("position", "Weg [mm]", "mm", 4), separator=";", decimal=",", newline="\r\n",
)  # fmt: skip
TABS = columns(
    ("Timestamp", "us", 0), ("AI0 [V]", "V", 6), ("AI1 [V]", "V", 6),
    ("position", "encoder (µm)", "um", 1), separator="\t", suffix=".txt",
)  # fmt: skip
SPEEDS = columns(
    ("time_s", "s", 4), ("voltage_0_mV", "mV", 3), ("voltage_1_mV", "mV", 3),
    ("speed", "Stage velocity [mm/s]", "mm/s", 3), ("Temp (degC)", "", 1),
)  # fmt: skip
ENCODER = columns(
    ("Time (ms)", "ms", 1), ("Ch A [V]", "V", 6), ("Ch B [V]", "V", 6),
    ("position", "Encoder (mm)", "mm", 2), preamble="# run 3\n# 2024-05-01\n",
)  # fmt: skip
RIGS = [
    Rig("as the example", stated=stated()),
    Rig("one strip of reversed polarity, there and back, in cm with decimal commas",
        gains=(-80.0,), passes=2, depth_m=1.05e-3, speed_m_per_s=0.03, friction=0.5,
        format=CM, stated=stated(1e-3, [0.0])),
    Rig("one strip, one way, far from the stage's zero",
        gains=(120.0,), depth_m=0.9e-3, speed_m_per_s=0.025, rate_hz=3000.0, origin_m=0.05,
        stated=stated(1e-3, [0.0]), to_invert=("friction=0.35",)),
    Rig("tabs, microseconds, one sign reversed, hum of 60 and 180 Hz, lost and blank rows",
        angle_deg=60.0, offset_m=-2e-3, gains=(60.0, -140.0), mains_Hz=59.95, hum=2.0,
        speed_m_per_s=0.015, rate_hz=1000.0, lost=20, blank=10, format=TABS,
        stated=stated(1.1e-3, [0.0, 55.0], [0.0, -1.8e-3])),
    Rig("towards -x first, back, with drift",
        drift=0.3, passes=2, angle_deg=90.0, offset_m=0.8e-3, depth_m=0.8e-3, backwards=True,
        rate_hz=4000.0, stated=stated(0.75e-3, [0.0, 85.0], [0.0, 1e-3])),
    Rig("six passes, hum and drift, lost rows, a late clock",
        hum=3.0, drift=0.1, passes=6, lost=60, angle_deg=30.0, origin_m=0.085, start_s=12.5,
        stated=stated(angles_deg=[0.0, 35.0], offsets_m=[0.0, 1.4e-3])),
    Rig("a fast stage, hum where the ridge's waves pass",
        speed_m_per_s=0.1, rate_hz=10000.0, hum=3.0, passes=2, gains=(-95.0, -110.0),
        stated=stated()),
    Rig("speeds in place of positions, towards -x",
        backwards=True, speed_m_per_s=0.01, rate_hz=800.0, hum=1.0, mains_Hz=60.05, angle_deg=20.0,
        noise=0.1, format=SPEEDS,
        stated=stated(angles_deg=[0.0, 28.0], offsets_m=[0.0, 1.2e-3], scan_start_m=0.015)),
    Rig("an encoder of 10 um, an uneven speed, much noise",
        ripple=0.05, angle_deg=70.0, offset_m=1e-3, depth_m=1.4e-3, friction=0.6, noise=0.15,
        start_s=3.2, format=ENCODER, stated=stated(1.2e-3, [0.0, 75.0], [0.0, 1e-3])),
    Rig("a slow stage, hum and drift",
        speed_m_per_s=0.004, rate_hz=500.0, drift=0.2, hum=1.0, stated=stated()),
    Rig("columns of German names", format=GERMAN, angle_deg=50.0, gains=(-70.0, 70.0),
        friction=0.2, stated=stated()),
]  # fmt: skip
