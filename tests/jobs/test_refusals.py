"""What a command cannot do: exit code 2, one line with the key and the value, nothing left."""

import numpy as np
import pytest

from srsinv.recording import Recording, save
from tests.jobs.run import command
from tests.jobs.sidecars import SENSOR
from tests.tiers import quick

SAMPLES = 60
TINY = "grid.cells=16 grid.refinement=1"
INVERT = "experiment=invert_recording recording.path"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The current folder, with recordings that are each wrong in one way."""
    folder = tmp_path_factory.mktemp("here")
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
        recording = Recording(values, 1e-3 * ramp, speed, channels, {"sensor": SENSOR})
        save(recording, folder / name)
    (folder / "speedless.csv").write_text(
        "time_s,voltage_0_V\n" + "".join(f"{i}e-4,{i % 7}\n" for i in range(SAMPLES))
    )
    (folder / "words.txt").write_text("a,b\nx,y\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


# what is typed -> words of the line, of which the first two of an override are its key and value
REFUSALS = {
    # Recordings
    "experiment=invert_recording": ["recording.path"],
    f"{INVERT}=absent.csv": ["absent.csv", "no such file"],
    f"{INVERT}=holed.csv": ["holed.csv", "voltage_1_V", "row 5", "recording.missing=allow"],
    f"{INVERT}=still.csv": ["still.csv", "recording.speed_m_per_s="],
    f"{INVERT}=speedless.csv": ["speedless.csv", "recording.speed_m_per_s="],
    f"{INVERT}=speedless.csv recording.speed_m_per_s=0.05": ["sensor.elements"],
    f"{INVERT}=good.csv recording.channels=[voltage_0_V,volts]": ["'volts'", "voltage_1_V"],
    f"{INVERT}=good.csv recording.gain=0": ["good.csv", "gain", "0"],
    f"{INVERT}=good.csv sensor.depth_m=-1": ["depth_m", "-1.0"],
    f"{INVERT}=good.csv effects=auto": ["effects", "auto"],
    f"{INVERT}=good.csv effects=[load_drift]": ["effects", "load_drift"],
    "experiment=inspect_recording recording.path=words.txt": ["words.txt", "no column"],
    "experiment=fit_recording calibration=rig.yaml": ["calibration", "recording.calibration"],
    # Keys and choices
    "experiment=nope": ["'nope'", "srsinv --help"],
    "experiment=two_elements": ["'two_elements'", "'two_element'"],
    "sensor.dept_m=1": ["sensor.dept_m", "sensor.depth_m"],
    "+scan.speed=1": ["scan.speed", "speed_m_per_s"],
    "amplifier=loud": ["'loud'", "current"],
    "effects=[nope]": ["'nope'", "srsinv --help"],
    "scan=null": ["scan=null", "sliding"],
    "grid=null": ["grid", "null"],
    "tolerance=0.1": ["tolerance"],
    # Values and classes
    "scene.base_friction=rough": ["scene.base_friction", "'rough'"],
    "seed={a:1}": ["seed", "{'a': 1}"],
    "seed=[1,2]": ["seed", "[1, 2]"],
    "grid.cells=100000000000": ["grid.cells", "100000000000"],
    "grid.refinement=1000000": ["grid.refinement", "1000000"],
    "sensor.elements=null": ["sensor.elements"],
    "+noise.hum={hz:50}": ["noise.hum._target_", "null"],
    "skin._target_=srsinv.Skin": ["skin._target_", "'srsinv.Skin'"],
    "skin._target_=srsinv.grid.Open": ["skin._target_", "srsinv.grid.Open"],
    # What parts cannot do together
    "effects=auto tolerance=2": ["tolerance", "2"],
    "effects=auto tolerance=0": ["tolerance", "0"],
    "effects=auto scan.speed_m_per_s=0": ["speed_m_per_s"],
    "scan.speed_m_per_s=0": ["speed_m_per_s", "0"],
    f"{TINY} effects=[sampling] effects.sampling.rate_hz=10": ["effects.sampling.rate_hz"],
    f"{TINY} effects=[oblique_features] effects.oblique_features.angle_deg=90": ["give a smaller"],
    f"{TINY} scene=ridge scene.surfaces.ridge.height_m=0": ["no signal", "noise=[white]"],
    f"{TINY} sensor=one_element": ["friction"],
    "grid.line=open grid.cells=64 method=tikhonov method.tikhonov.path=spectral": [
        "spectral", "path=auto"
    ],
}  # fmt: skip
OF_EXPERIMENTS = {
    **{f"experiment={each.split('.')[0].split('=')[0]} {each}": [] for each in (
        "calibration_of_bands.prior.rms_Pa=-1", "calibration_of_bands.methods=[nobody]",
        "calibration_of_bands.conformal.passes=3", "calibration_of_bands.ranges=null",
        "circular_scan=null", "circular_scan.ridge=null", "circular_scan.angles_deg=[a]",
        "circular_scan.angles_deg=[nan]", "circular_scan.angles_deg=[[1,2]]",
        "circular_scan.shown_deg=null", "circular_scan.gain_angles=-1",
        "circular_scan.circle.samples=1000000000", "circular_scan.circle.radius_m=1e12",
        "circular_scan.ridge.load_N_per_m=0", "circular_scan.ridge.width_m=1e-300",
        "compare=null", "compare.scene_sensor=null", "coverage=null",
        "effects_auto.scenes.strip=null", "fig05_orientation.load_width_m=0",
        "fig12_ridges.most_ridges=0", "fig12_ridges.pitch_range_m=[0,1]",
        "fig12_ridges.pitch_range_m=null", "hard_cases.precisions=[]", "model_error.points=0",
        "model_error.truths=null", "model_error.wavelengths_m=[a,b]", "plan=null",
        "two_element.angles_deg=null",
    )},
    **{f"experiment=example_recording example.{each}": [] for each in (
        "rig=null", "rig.gain=null", "sample_rate_hz=1e-9", "speed_m_per_s=0"
    )},
    "experiment=fig10_11 truth=null": [],
}  # fmt: skip


# Of the experiments' keys every third is for `make test-all`, and the rest for `make claims`.
EVERY = REFUSALS | OF_EXPERIMENTS
CASES = [
    *quick(REFUSALS, *list(REFUSALS)[::12]),
    *(pytest.param(typed, marks=pytest.mark.claim if i % 3 else pytest.mark.full)
      for i, typed in enumerate(OF_EXPERIMENTS)),
]  # fmt: skip


@pytest.mark.parametrize("typed", CASES)
def test_a_command_is_refused_in_one_line(folder, capsys, typed):
    before = sorted(folder.rglob("*"))
    assert command("run", *typed.split()) == 2
    captured = capsys.readouterr()
    said = [line for line in captured.err.splitlines() if not line.endswith(" ...")]  # stages
    assert (captured.out, len(said)) == ("", 1)
    assert said[0].startswith("srsinv: ")
    assert [word for word in EVERY[typed] if word not in said[0]] == [], said
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("typed", ["seed=range(0,0)", "seed=glob(*)", "effects=glob(*)"])
def test_a_sweep_of_no_jobs_or_of_any_is_refused(folder, capsys, typed):
    assert command("run", "-m", typed) == 2
    assert "give at least" in (said := capsys.readouterr().err) or "name the options" in said
