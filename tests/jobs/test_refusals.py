"""Every wrong input gets one sentence that names it and the remedy, and leaves nothing behind."""

import re

import numpy as np
import pytest

from srsinv.recording import Recording, save
from tests.jobs.run import command

pytestmark = pytest.mark.full

SENSOR = {
    "depth_m": 7.5e-4,
    "feedback_resistance_ohm": 1e6,
    "elements": [
        {"orientation": name, "strip_width_m": 7e-4, "active_length_m": 8e-3}
        for name in ("1_to_x_3_to_z", "1_to_z_3_to_x")
    ],
}
SAMPLES = 60
TINY = ("grid.cells=16", "grid.refinement=1")
INVERT = ("experiment=invert_recording",)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with recordings that are each wrong in one way."""
    monkeypatch.chdir(tmp_path)
    ramp = np.linspace(0, 1, SAMPLES)
    signal = np.stack([np.sin(20 * ramp), np.cos(20 * ramp)])
    holed = signal.copy()
    holed[1, 4] = np.nan
    for name, values, speed in (
        ("good.csv", signal, 0.05 + 0 * ramp),
        ("still.csv", signal, 0 * ramp),
        ("holed.csv", holed, 0.05 + 0 * ramp),
    ):
        channels = ("voltage_0_V", "voltage_1_V")
        save(Recording(values, 1e-3 * ramp, speed, channels, {"sensor": SENSOR}), name)
    (tmp_path / "speedless.csv").write_text(
        "time_s,voltage_0_V\n" + "".join(f"{i}e-4,{i % 7}\n" for i in range(SAMPLES))
    )
    return tmp_path


def of(name, *overrides):
    return (*INVERT, f"recording.path={name}", *overrides)


REFUSALS = {
    "a calibration without recording": (
        ("experiment=fit_recording", "calibration=rig.yaml"),
        r"no key 'calibration'; the nearest is 'recording\.calibration'",
    ),
    "all effects left out": (("effects=auto", "tolerance=2"), r"tolerance is 2: .* below 1"),
    "no file named": (INVERT, r"'recording\.path' has no value; give one"),
    "missing file": (of("absent.csv"), r"absent\.csv: there is no such file"),
    "missing column": (
        of("good.csv", "recording.channels=[voltage_0_V,volts]"),
        r"no column 'volts': the nearest is voltage_1_V,.* name one of them",
    ),
    "NaN cell": (
        of("holed.csv"),
        r"voltage_1_V, data row 5 is empty: correct it.*recording\.missing=allow",
    ),
    "speed 0 recorded": (
        of("still.csv"),
        r"still\.csv: the speed is 0.* give recording\.speed_m_per_s=",
    ),
    "no speed": (of("speedless.csv"), r"no speed: .* give recording\.speed_m_per_s="),
    "no film element": (
        of("speedless.csv", "recording.speed_m_per_s=0.05"),
        r"No film element is known: give sensor\.elements",
    ),
    "negative recorded depth": (
        of("good.csv", "sensor.depth_m=-1"),
        r"depth_m is -1\.0: give a positive length",
    ),
    "negative cell": (
        of("good.csv", "recording.cell_m=-1"),
        r"recording\.cell_m is -1: give a positive width",
    ),
    "negative depth": (("sensor.depth_m=-1",), r"depth_m is -1\.0: give a positive length"),
    "unknown experiment": (
        ("experiment=nope",),
        r"no experiment 'nope'; there are .*invert_recording",
    ),
    "near experiment": (
        ("experiment=two_elements",),
        r"no experiment 'two_elements'; the nearest is 'two_element'",
    ),
    "unknown key": (
        ("sensor.dept_m=1",),
        r"no key 'sensor\.dept_m'; the nearest is 'sensor\.depth_m'",
    ),
    "too few cells": (("grid.cells=2",), r"grid\.cells is 2: .*give a whole number from 3"),
    "negative length": (("grid.length_m=-1",), r"grid\.length_m is -1: give a positive length"),
    "speed 0": (("scan.speed_m_per_s=0",), r"speed_m_per_s is 0, .*give a speed"),
    "unknown line": (("grid.line=closed",), r"grid\.line is 'closed': give one of periodic, open"),
    "orientation": (
        ("sensor.elements.along.orientation=sideways",),
        r"along\.orientation is 'sideways': give one of 1_to_x_3_to_z",
    ),
    "effect": (("effects=[nope]",), r"no effects 'nope'; there are amplifier_bandwidth, "),
    "tolerance": (("tolerance=0.1",), r"no key 'tolerance'"),
    "static, with effects to decide on": (
        ("effects=auto", "scan.speed_m_per_s=0"),
        r"a static touch gives no rate signal",
    ),
    "no tolerance": (("effects=auto", "tolerance=0"), r"tolerance is 0: give a number above 0"),
    "auto of a recording": (
        of("good.csv", "effects=auto"),
        r"effects=auto decides by a simulated scene.*name the effects",
    ),
    "drift of a recording": (
        of("good.csv", "effects=[load_drift]"),
        r"effects names load_drift, which acts on a simulated scene.*leave it out",
    ),
    "too few samples": (
        (*TINY, "effects=[sampling]", "effects.sampling.rate_hz=10"),
        r"samples for each of the .* cells.*raise effects\.sampling\.rate_hz",
    ),
    "along the features": (
        (*TINY, "effects=[oblique_features]", "effects.oblique_features.angle_deg=90"),
        r"the sensor does not move across what it feels",
    ),
    "precision": (("precision=float16",), r"precision is 'float16': give float64 or float32"),
    "spectral on open line": (
        ("grid.line=open", "grid.cells=64", "method=tikhonov", "method.tikhonov.path=spectral"),
        r"path=spectral needs a periodic line.*use path=auto",
    ),
    "order": (("method.tikhonov.order=3",), r"order is 3: give 0, 1 or 2"),
    "snr": (
        ("noise.snr.snr_dB=loud",),
        r"'noise\.snr\.snr_dB' takes a number, not 'loud'; it is 40\.0",
    ),
    "no signal": (
        (*TINY, "scene=ridge", "scene.surfaces.ridge.height_m=0"),
        r"gives no signal at all.* noise=\[white\]",
    ),
    "friction of one element": (
        (*TINY, "sensor=one_element"),
        r"One element cannot tell p from q: give friction",
    ),
    "negative resistance": (
        ("amplifier.feedback_resistance_ohm=-1",),
        r"feedback_resistance_ohm is -1: give a positive resistance",
    ),
}


@pytest.mark.parametrize(("arguments", "sentence"), REFUSALS.values(), ids=REFUSALS)
def test_one_sentence_and_nothing_left(folder, capsys, arguments, sentence):
    before = sorted(folder.rglob("*"))
    assert command("run", *arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert re.fullmatch(r"srsinv: .*\n", captured.err)
    assert re.search(sentence, captured.err)
    assert sorted(folder.rglob("*")) == before
