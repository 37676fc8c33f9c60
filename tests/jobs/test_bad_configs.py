"""Every number and every choice of the jobs' configurations, set to what it cannot be.

Each case is refused in one sentence that names the key and the value, before anything is computed:
what computes is replaced by what says that it was reached.
"""

import copy
import math
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from srsinv.__main__ import find_config_root
from srsinv.recording import Recording, save
from tests.jobs.run import result_of
from tests.jobs.sidecars import SENSOR
from tests.refusals import refused
from tests.tiers import quick

FILE = "recording.path=tiny.csv"
OVERRIDES = {
    "simulate": ("grid.cells=16", "rule=evidence"),
    "invert_recording": ("experiment=invert_recording", FILE, "noise=[white,sliding]"),
    "fit_recording": (
        "experiment=fit_recording",
        "feature=[strip_load,hertz_load,line_load,step_load,grating]",
    ),
    "fit_fabricslide": (
        "experiment=fit_fabricslide",
        FILE,
        "recording.channels=[voltage_0_V,voltage_1_V]",
        "feature.pitch_range_m=[0.0003,0.0008]",
    ),
    "inspect_recording": ("experiment=inspect_recording", FILE),
}
COMPUTING = (
    "simulate.noisy_problem",
    "invert_recording.invert",
    "fit_recording._fit",
    "fit_fabricslide.fit_pitch",
    "inspect_recording._numbers",
)
# What each job reads of its configuration, and no other job before it reads in the same way.
READ = {
    "simulate": "scene skin sensor amplifier scan noise method seed grid",
    "invert_recording": "skin sensor amplifier noise recording",
    "fit_recording": "feature solver",
    "fit_fabricslide": "fit_fabricslide",
    "inspect_recording": "recording",
}


class Reached(Exception):
    """The configuration was taken, and computing began."""


@cache
def composed(job: str) -> dict[str, Any]:
    with initialize_config_dir(str(find_config_root()), version_base="1.3"):
        cfg = compose("config", list(OVERRIDES[job]))
    return OmegaConf.to_container(cfg, resolve=True)


def leaves(node: Any, prefix: str = ""):
    if isinstance(node, dict):
        for name, value in node.items():
            yield from leaves(value, f"{prefix}{name}.")
    else:
        yield prefix[:-1], node


WRONG = ("loud", [0.5, 0.5, 0.5], math.nan, math.inf, 1e300, True, {"value": 1.0})
NO_NUMBERS = {"elements", "piezo_constants_C_per_N", "path", "sidecar", "channels", "time_unit",
              "signal_unit", "mains_Hz", "detrend", "notch_Hz", "unusable", "wiring"}  # fmt: skip
EITHER_SIGN = re.compile(
    r"pressure_Pa|background_pressure_Pa|.*friction|change|.*position_m|.*start_m|offset_m|d[123]"
    r"|snr_dB|angle_deg|speed_m_per_s|polarity|backlash_m"
)
FROM_ZERO = re.compile(r"order|poisson_ratio|seed|fraction|correlation_m|nominal_pressure_Pa|drift")
# What cannot be elsewhere, and is taken here: (job, keys, value, why).
TAKEN = (
    ("simulate", r"sensor\.strips", None, "one strip"),
    ("simulate", r"sensor\.elements\.\w+\.offset_m", None, "no offset"),
    ("invert_recording", r"recording\.gain", 1e300, "any unit; the noise is refused as too small"),
    (".*_recording", r"recording\.(gain|polarity|drift)", [0.5, 0.5, 0.5], "one for each channel"),
    (
        "inspect_recording",
        r"recording\.(gain|sample_rate_hz|drift|high_pass_Hz|notch_width_Hz|turn_margin_m)",
        1e300,
        "nothing is computed",
    ),
    ("fit_recording", r"solver\.max_steps", True, "one step"),
)
# Parts of a kind with another one.
ALIKE = re.compile(r"scene\.frictions\.back.*|sensor\.elements\.upright.*|method\.wiener\.q.*")
# A first look at a file uses no physics: what it does not need it hands on to the sidecar.
UNUSED_BY_INSPECTION = re.compile(
    r"recording\.(nominal_pressure_Pa|cell_m|.*_m_per_s|scan_start_m|backlash_m|tolerance\..*)"
)


def numbers(job: str):
    """The keys of the job that hold a number, or may."""
    read = READ[job].split()
    for key, value in leaves({name: composed(job)[name] for name in read}):
        last = key.rpartition(".")[2]
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if ALIKE.fullmatch(key) or (
            job == "inspect_recording" and UNUSED_BY_INSPECTION.fullmatch(key)
        ):
            continue
        if is_number or (value is None and last not in NO_NUMBERS):
            yield key, last, value


def is_taken(job: str, key: str, value: Any) -> bool:
    return any(
        re.fullmatch(jobs, job) and re.fullmatch(keys, key) and repr(value) == repr(taken)
        for jobs, keys, taken, _ in TAKEN
    )


def wrong_numbers():
    """Every key with what it cannot be: its own bound, and by turns two of what no key can."""
    for job in READ:
        for at, (key, last, value) in enumerate(numbers(job)):
            wrong = [WRONG[(at + turn) % len(WRONG)] for turn in (0, 2)]
            if value is not None:
                wrong.append(None)
            if not EITHER_SIGN.fullmatch(last):
                wrong += [-1.0] if FROM_ZERO.fullmatch(last) else [-1.0, 0]
            yield job, key, [each for each in wrong if not is_taken(job, key, each)]


def described(value: Any) -> re.Pattern[str]:
    """How a sentence may write a value: as it is, or the part of it that is wrong."""
    words = [repr(value)]
    if value is None or value is True:
        words += ["null", "true", "No "]
    elif isinstance(value, str):
        words += [value, value.rpartition(".")[2]]
    elif isinstance(value, list):
        words += map(repr, value)
    return re.compile("|".join(map(re.escape, words)))


def run(cfg: dict[str, Any]):
    """The job as far as its first computing."""
    result_of(cfg)


def reached(*_, **__):
    raise Reached


def changed(job: str, key: str, value: Any) -> dict[str, Any]:
    cfg = copy.deepcopy(composed(job))
    *above, last = key.split(".")
    node = cfg
    for name in above:
        node = node[name]
    node[last] = value
    return cfg


@pytest.fixture(autouse=True, scope="module")
def folder(tmp_path_factory):
    """The current folder, with one small recording; and nothing computes."""
    folder = tmp_path_factory.mktemp("here")
    time_s = 1e-3 * np.arange(60)
    signal = np.stack([np.sin(3e2 * time_s), np.cos(5e2 * time_s)])
    recording = Recording(
        signal, time_s, 0.05 + 0 * time_s, ("voltage_0_V", "voltage_1_V"), {"sensor": SENSOR}
    )
    save(recording, folder / "tiny.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for function in COMPUTING:
            patch.setattr(f"srsinv.jobs.{function}", reached)
        yield folder


def name(part: Any) -> str:
    return part if isinstance(part, str) else "wrong"


def refusal(job: str, key: str, value: Any) -> str:
    return refused(lambda: run(changed(job, key, value)))


@pytest.mark.parametrize(
    ("job", "key", "values"),
    list(wrong_numbers()),
    ids=name,
)
def test_a_number_that_cannot_be(job, key, values):
    for value in values:
        sentence = refusal(job, key, value)
        assert key.rpartition(".")[2] in sentence, value
        assert described(value).search(sentence), sentence


UNORDERED = (0.5, "wide", [0.5], [0.6, 0.5], [0.1, math.nan], ["a", "b"], {"least": 0.1})
NO_CHOICE = ("nope", 3, ["nope"], None, {"name": "nope"})
NO_CLASS = ("srsinv.forward.Nope", "srsinv.jobs.simulate.run", "srsinv.grid.Periodic", None, 3)
NO_MAPPING = (3, [1.0, 2.0])
# Each of the keys with each of the values.
OTHERS = (
    ("fit_recording", "feature.strip_load.position_range_m feature.grating.phase_range_rad",
     UNORDERED),
    ("fit_recording", "feature.hertz_load.half_width_range_m feature.grating.pitch_range_m "
     "feature.grating.duty_range", (*UNORDERED, [-0.5, 0.5])),
    ("fit_fabricslide", "feature.pitch_range_m",
     (None, 4e-4, [4e-4], [8e-4, 3e-4], [0.0, 8e-4], ["a", 8e-4], [3e-4, 1.0], [1e-9, 8e-4])),
    ("invert_recording", "recording.contact_window_m",
     (0.5, "all", [0.0], [0.01, 0.0], [0.0, math.inf], [-1e12, 1e12], {"start": 0})),
    ("invert_recording", "recording.mains_Hz", ("loud", 0.0, -50.0, [50.0, "a"], math.nan)),
    ("invert_recording", "recording.drift", (-1.0, "loud", math.nan, [-1e-6])),
    ("invert_recording", "recording.detrend", ("quadratic", 1, True, ["linear"])),
    ("invert_recording", "recording.unusable", ("refuse", 1, True, ["keep"])),
    ("invert_recording", "recording.wiring", ("found", 1, True, ["as_stated"])),
    ("invert_recording", "recording.notch_Hz",
     ("auto", 0.0, -50.0, [], [50.0, "a"], math.nan, 500.0, [50.0, 1.0])),
    ("invert_recording", "recording.high_pass_Hz", (500.0, 1.0)),
    ("invert_recording", "recording.sidecar", (3, ["a.json"])),
    ("invert_recording", "recording.channels", (3, {"a": 1}, [])),
    ("fit_recording", "recording.path", (3, ["a.csv"], {"file": "a.csv"})),
    ("simulate", "effects", ("strip_width", 3, [3], ["nope"])),
    ("simulate", "friction", ("rough", [0.4], math.nan, math.inf, True, {"mu": 0.4})),
    ("simulate", "precision grid.line sensor.elements.along.orientation method.wiener.scale "
     "method.wiener.path method.tikhonov.path", NO_CHOICE),
    ("invert_recording", "recording.missing", NO_CHOICE),
    ("invert_recording", "recording.times", NO_CHOICE),
    ("invert_recording", "traction_unit", NO_CHOICE),
    ("fit_recording", "fit.select", NO_CHOICE),
    ("fit_recording", "fit.samples", (True, "many", 49, 100.5, -1, None, [100])),
    ("simulate", "scene._target_ scene.pressures.strip._target_ skin._target_ scan._target_ "
     "method.tikhonov._target_ method.wiener.p._target_ method.tikhonov.rule._target_", NO_CLASS),
    ("invert_recording", "noise.sliding._target_", NO_CLASS),
    ("fit_recording", "feature.grating._target_ solver._target_ amplifier._target_", NO_CLASS),
    ("simulate", "grid scene scene.pressures scene.frictions.up skin scan amplifier noise "
     "noise.snr sensor sensor.elements sensor.elements.along sensor.piezo_constants_C_per_N method "
     "method.wiener method.wiener.p method.tikhonov.rule", NO_MAPPING),
    ("invert_recording", "recording noise.white skin sensor", NO_MAPPING),
    ("fit_recording", "fit feature feature.grating solver", NO_MAPPING),
)  # fmt: skip
EACH_OTHER = [(job, key, values) for job, keys, values in OTHERS for key in keys.split()]


@pytest.mark.parametrize(("job", "key", "values"), quick(EACH_OTHER, *EACH_OTHER[::3]), ids=name)
def test_a_choice_a_range_or_a_structure_that_cannot_be(job, key, values):
    for value in values:
        sentence = refusal(job, key, value)
        assert key.removesuffix("._target_").rpartition(".")[2] in sentence, value
        assert described(value).search(sentence), sentence


RIGHT = [
    *((job, "precision", "float64") for job in READ),
    ("simulate", "sensor.strips", None),
    ("simulate", "sensor.elements.along.offset_m", None),
    ("simulate", "sensor.elements.along.angle_deg", -30),
    ("simulate", "sensor.elements.along.depth_m", 1),
    ("simulate", "scan.speed_m_per_s", -0.05),
    ("simulate", "method.tikhonov.weight_p", 1e-9),
    ("simulate", "noise", None),
    ("simulate", "scene.pressures", {}),
    ("simulate", "effects", {}),
    ("simulate", "effects", None),
    ("simulate", "friction", -0.4),
    ("simulate", "grid.cells", 64.0),
    ("invert_recording", "recording.polarity", [-1, 1]),
    ("invert_recording", "recording.contact_window_m", [-0.001, 0.004]),
    ("invert_recording", "recording.nominal_pressure_Pa", 0),
    ("invert_recording", "recording.mains_Hz", [50, 150.0]),
    ("invert_recording", "recording.mains_Hz", "auto"),
    ("invert_recording", "recording.mains_Hz", []),
    ("invert_recording", "recording.drift", 1e-6),
    ("invert_recording", "recording.detrend", "linear"),
    ("invert_recording", "recording.high_pass_Hz", 20),
    ("invert_recording", "recording.drift", "auto"),
    ("invert_recording", "recording.speed_m_per_s", -0.02),
    ("fit_recording", "feature.strip_load.width_range_m", [1e-4, 0.01]),
    ("fit_recording", "noise.white.rms", 1e-7),
    ("fit_recording", "solver.max_steps", 100.0),
    ("inspect_recording", "recording.sample_rate_hz", 1e300),
]


@pytest.mark.parametrize(("job", "key", "value"), quick(RIGHT, *RIGHT[::10]), ids=str)
def test_what_is_right_is_computed(job, key, value):
    with pytest.raises(Reached):
        run(changed(job, key, value))
