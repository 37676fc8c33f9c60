"""A recording's sensor and its inverse problem, by the facts of its sidecar.

Python (`srsinv.invert`) and the command (`config.recorded_problem`) take the same way.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from . import false_alarm, parts
from .effects import add_effects
from .errors import BadInput, of_kind, refuse
from .forward.describe import elements
from .forward.film import Film
from .forward.noise import Noise
from .forward.scan import ConstantSpeed, Motion
from .forward.scenario import Scenario
from .forward.sensor import Sensor
from .inverse.kernel.operator_model import OperatorModel, Theory
from .inverse.noise.correlated import with_trend
from .inverse.noise.hum import Hum
from .inverse.noise.model import SampleNoise
from .inverse.noise.quiet import quiet_noise
from .inverse.nonlinear import LEVEL_STDERR
from .inverse.problem import Problem
from .inverse.rig.error import RigError, SensorError
from .inverse.rig.tolerance import rig_error_of
from .inverse.rig.wiring import WiringFinding, wiring_finding
from .modules import with_fields
from .recording import Recording
from .recording._speed import position_step
from .recording.drift import drift_of, shared_levels
from .recording.even import VOLTS, check_volts, on_even_times
from .recording.mains import MainsLine, mains_lines
from .recording.noise import ABOVE_CUTOFF, level_stderr, white_levels
from .recording.passes import go_both_ways, passes_of, with_backlash
from .recording.preparation import preparation_warnings, prepare
from .recording.unusable import without_unusable

LEAST_STEP = 1e-4  # of the depth: positions that are rounded to less move nothing
MOST_DRIFT = 1e4  # in a second, of the largest sample: more is another unit
SKIN = {"poisson_ratio": 0.5, "youngs_modulus_Pa": 7e5}  # where nothing else gives them
# The nodes of a recording's sensor where no configuration states others: those of config.yaml.
STATED = {
    "sensor": {},
    "skin": {parts.TARGET: "srsinv.forward.skin.HalfSpace"},
    "amplifier": {
        parts.TARGET: "srsinv.forward.amplifier.CurrentAmplifier",
        "feedback_resistance_ohm": None,
    },
    "effects": {
        "strip_width": {parts.TARGET: "srsinv.effects.strip_width.StripWidth"},
        "element_offsets": {parts.TARGET: "srsinv.effects.element_offsets.ElementOffsets"},
    },
}


def problem_of(
    recording: Recording,
    sensor: Sensor | None = None,
    *,
    noise: SampleNoise | Sequence[float] | float | None = None,
    causes: Mapping[str, Noise] | None = None,
    friction: Any = None,
    cell_m: Any = None,
    operator: OperatorModel | None = None,
    is_wired_as_stated: bool = False,
    are_straight_across: bool = True,
) -> Problem:
    """The problem of a recording at even times.

    - `sensor`: None takes it from the sidecar: see `sensor_of`.
    - `noise`: None takes the white noise's level from wavenumbers that the skin does not transmit;
      `causes`: of coloured noise beside the white one.
    - samples that are stuck, clipped or stand out of the noise are missing, with a warning; the
      fact `unusable` keeps them.
    - the fact `ways` of the sidecar takes the passes of one direction of motion, `onwards` or
      `back`.
    - the facts `mains_Hz` and `drift` of the sidecar add lines of mains and a drift (where no lines
      are named, those that are no texture are added, with a warning), and `quiet_s` names stretches
      from which the noise is taken; what `detrend`, `high_pass_Hz` and `notch_Hz` take out of the
      signal is warned of.
    - the facts `rig_error` and `tolerance` say how well the rig is known (see `rig_error_of`).
    - `operator`: how the sensor's response is known; None: by its theory. A measured kernel stands
      in place of the films' and of what a calibration found, errors included.
    - elements are taken as wired as the signals say where these leave no doubt, with a warning; the
      fact `wiring` or `is_wired_as_stated` takes them as stated.
    - `are_straight_across`: whether what is scanned is straight across the motion, as the check of
      the wiring takes it. Of features at an angle only a fault beyond doubt is reported.
    - `friction`, `cell_m` [m]: as [`Problem`][] has them; the nominal pressure and the window are
      those of the sidecar.

    Raises `BadInput` for missing facts, for a sensor of another number of elements, and where no
    noise is found in the signal.
    """
    recording = prepare(recording)
    sensor = sensor_of(recording) if sensor is None else sensor
    _check_elements(recording, of_kind("sensor", sensor, Sensor, "a Sensor").elements)
    _check_unit(recording, sensor)
    recording, unusable = without_unusable(recording, float(sensor.depth_m))
    if noise is None:
        noise = noise_of(recording, float(sensor.depth_m), causes)
    elif not isinstance(noise, SampleNoise):
        noise = SampleNoise(noise, causes)
    operator = Theory() if operator is None else operator
    sensor = operator.sensor(sensor)
    named = mains_of(recording)
    hum = Hum.of(recording, float(sensor.depth_m), named, noise.rms)
    window = recording.sidecar.get("contact_window_m")
    problem = Problem(
        sensor,
        motion_of(recording),
        recording.signal,
        _with_drift(recording, noise),
        friction=friction,
        nominal_pressure_Pa=recording.sidecar.get("nominal_pressure_Pa"),
        window_m=None if not window else (float(window[0]), float(window[1])),
        cell_m=cell_m,
        mains=named or hum.unnamed,
        position_step_m=_step_of(recording, float(sensor.depth_m)),
        # Signals in another unit than volts give a pressure in no unit.
        modulus_Pa=sensor.skin.surface_modulus_Pa if recording.signal_unit in VOLTS else None,
        name=recording.name,
    )
    direction = {"onwards": True, "back": False}.get(recording.sidecar.get("ways") or "both")
    problem = problem if direction is None else problem.of_direction(direction)
    keeps_wiring = is_wired_as_stated or recording.sidecar.get("wiring") == "as_stated"
    problem, of_wiring = _wired(recording, problem, keeps_wiring, are_straight_across)
    # By the passes back alone q is what acts in them.
    acts = (
        -float(problem.friction)
        if problem.friction is not None and direction is False
        else friction
    )
    warnings = (*_warnings(recording, problem, hum), *unusable, *of_wiring)
    rig = _rig_error(recording, problem.sensor, operator)
    return with_fields(problem, rig=rig, warnings=(*warnings, *operator.warnings(acts)))


def stated_problem(
    recording: Recording, sensor: Sensor, noise: SampleNoise, friction: Any = None
) -> Problem:
    """The problem of a few samples of a recording, with what the facts state and nothing that has
    to be found in the signals: neither noise nor drift, mains, or the elements' wiring.

    Raises `BadInput` where the facts ask to find drift or mains.
    """
    for key in ("mains_Hz", "drift"):
        refuse(
            recording.sidecar.get(key) == "auto",
            f"recording.{key}=auto needs a whole recording: give a number, or recording.path=FILE, "
            "an earlier recording of the sensor.",
        )
    _check_unit(recording, sensor)
    drift, mains = recording.sidecar.get("drift"), recording.sidecar.get("mains_Hz")
    named = [] if mains is None else [float(each) for each in np.ravel(mains)]
    white, own_drift = np.asarray(noise.white), 0.0 if drift is None else np.ravel(drift).tolist()
    return Problem(
        sensor,
        motion_of(recording),
        recording.signal,
        SampleNoise(white, is_estimate=noise.is_estimate, drift=own_drift),
        friction=friction,
        nominal_pressure_Pa=recording.sidecar.get("nominal_pressure_Pa"),
        mains=tuple(MainsLine(each, 0.0, np.zeros(len(recording.channels))) for each in named),
        name=recording.name,
    )


def _rig_error(recording: Recording, sensor: Sensor, operator: OperatorModel) -> SensorError | None:
    """How well the sensor and what stands beside it are known."""
    facts, name = recording.sidecar, recording.name
    if not isinstance(operator, Theory):
        given = facts.get("rig_error")
        return operator.error or RigError.of_facts(name, given, len(recording.channels))
    return rig_error_of(
        name,
        facts,
        sensor,
        has_measured_positions=recording.measured_position_m is not None,
        nominal_pressure_Pa=facts.get("nominal_pressure_Pa"),
    )


def _warnings(recording: Recording, problem: Problem, hum: Hum) -> tuple[str, ...]:
    """Warnings on the recording itself, as sentences."""
    depth_m, amplifier = float(problem.sensor.depth_m), problem.sensor.amplifier
    of_calibration = (recording.sidecar.get("rig_error") or {}).get("warnings")
    # Up to here the skin transmits waves, of which the preparation of the signals may take some.
    fastest = float(np.max(np.abs(recording.speed_m_per_s)))
    highest_Hz = fastest * ABOVE_CUTOFF / (2 * np.pi * depth_m)
    has_offset = amplifier.order == 0 and amplifier.offset is not None
    return (
        *recording.doubts,
        *((f"The rig's calibration was doubtful: {of_calibration}",) if of_calibration else ()),
        *preparation_warnings(recording, highest_Hz, has_offset),
        *hum.warnings,
    )


def _with_drift(recording: Recording, noise: SampleNoise) -> SampleNoise:
    """The noise with the drift that the facts state, or that is found, if any."""
    given = recording.sidecar.get("drift")
    if not given:
        return noise
    if given == "auto":
        drift = shared_levels(drift_of(recording, false_alarm.DRIFT_WHERE_NAMED))
    else:
        drift = np.ravel(given)
    most, largest = float(np.max(drift)), float(np.nanmax(np.abs(recording.signal)))
    refuse(
        most > MOST_DRIFT * largest,
        f"{recording.name}: recording.drift is {most:.4g} after 1 s, but no sample "
        f"exceeds {largest:.4g}: give it in the signal's unit, after the gain.",
    )
    return SampleNoise(
        noise.white,
        noise.causes,
        noise.is_estimate,
        drift.tolist(),
        level_stderr=noise.level_stderr,
        is_drift_found=given == "auto",
    )


def mains_of(recording: Recording) -> tuple[MainsLine, ...]:
    """The lines of mains that the facts name, as the recording has them; none where none are."""
    given = recording.sidecar.get("mains_Hz")
    if given is None:
        return ()
    listed = given if isinstance(given, list) else [given]
    named = None if given == "auto" else [float(each) for each in listed]
    return mains_lines(recording.signal, recording.sample_rate_hz, named)


def _step_of(recording: Recording, depth_m: float) -> float:
    """The step [m] to which the measured positions are rounded, 0 where that changes nothing."""
    position = recording.measured_position_m
    step_m = 0.0 if position is None else position_step(position) or 0.0
    return step_m if step_m > LEAST_STEP * depth_m else 0.0


def _check_unit(recording: Recording, sensor: Sensor) -> None:
    unit = sensor.amplifier.unit
    refuse(
        unit not in VOLTS and unit != recording.signal_unit,
        f"{recording.name}: the signal is in {recording.signal_unit}, but the "
        f"amplifier ({type(sensor.amplifier).__name__}) gives {unit}: choose an "
        "amplifier with the signal's unit, or give recording.gain.",
    )


def _wired(
    recording: Recording, problem: Problem, keeps_wiring: bool, are_straight_across: bool
) -> tuple[Problem, tuple[str, ...]]:
    """The problem with its elements wired as the signals say beyond doubt, and sentences on faults
    of their wiring; `keeps_wiring`: it stays as stated."""

    def counts(finding: WiringFinding | None) -> bool:
        # Features at an angle look like straight ones under a rig of another gain, depth or offset.
        return finding is not None and (finding.is_certain or are_straight_across)

    found = _wiring(recording, problem)
    if found is None or not counts(found):
        return problem, ()
    if keeps_wiring or not found.is_certain or found.wiring is None:
        return problem, (found.words,)
    wired = with_fields(problem, sensor=found.wiring.sensor(problem.sensor))
    if counts(_wiring(recording, wired)):  # neither wiring fits
        return problem, (found.words,)
    return wired, (
        f"{found.words} The answer takes it so: recording.wiring=as_stated takes the elements as "
        "stated.",
    )


def _wiring(recording: Recording, problem: Problem) -> WiringFinding | None:
    """What is found of the elements' wiring, where the recording can be put on a line, by the
    passes of one way."""
    if len(recording.channels) < 2:
        return None
    passes = passes_of(np.asarray(problem.motion.position_m))
    if problem.direction is None and go_both_ways(passes):
        problem = problem.of_direction(passes[0].is_onwards)
    # Noise that is found beside the signals would take a fault up.
    noise = with_fields(problem.noise, is_estimate=False)
    stated = with_fields(problem, noise=noise, rig=None)
    try:
        line = stated.to_grid()
    except BadInput:  # it is too short
        return None
    line = with_trend(line) if problem.noise.is_drift_found else line
    return wiring_finding(line, recording.channels, float(problem.sensor.depth_m))


def ready(recording: Recording) -> Recording:
    """The recording at even times. Raises `BadInput` where its signal is not in volts."""
    even = on_even_times(recording)
    check_volts(even)
    return even


def sensor_of(recording: Recording, stated: Mapping[str, Any] = STATED) -> Sensor:
    """The sensor of a recording: the nodes `sensor`, `skin`, `amplifier` and `effects` that are
    `stated`, and what they leave open from the facts of the sidecar. Raises `BadInput` for facts
    that are missing, and for a sensor that has not one element for each signal."""
    skin = recording.sidecar.get("skin") or {}
    model = skin.get("model", "half_space")
    refuse(
        model != "half_space",
        f"The sidecar's skin.model is {model!r}: give half_space, or leave it out.",
    )
    known = SKIN | {key: skin[key] for key in SKIN.keys() & skin.keys()}
    nodes = parts.with_facts(stated, recording.sidecar.get("sensor") or {}, known)
    _check_elements(recording, elements(nodes["sensor"]))
    refuse(
        stated is STATED and nodes["amplifier"]["feedback_resistance_ohm"] is None,
        f"{recording.name}: the feedback resistance is not known: give "
        "sensor.feedback_resistance_ohm in the sidecar, or a sensor.",
    )
    ideal = parts.sensor(nodes["sensor"], nodes["skin"], nodes["amplifier"])
    mean_speed = ConstantSpeed(float(np.mean(recording.speed_m_per_s)))
    without = Scenario(None, ideal, mean_speed).sliding()
    return add_effects(without, parts.effects_of_sensor(nodes["effects"])).sensor


def _check_elements(recording: Recording, films: tuple[Film, ...]) -> None:
    """Refuse a sensor that has not one element for each signal."""
    refuse(
        len(films) != len(recording.channels),
        f"{recording.name}: {len(recording.channels)} signal columns but {len(films)} "
        "film elements: give one column for each element in recording.channels.",
    )


def motion_of(recording: Recording) -> Motion:
    """The sensor's motion: the measured positions, else the integral of the speed, with the stage's
    backlash taken out that the facts state."""
    time_s, speed = recording.time_s, recording.speed_m_per_s
    backlash_m = float(recording.sidecar.get("backlash_m") or 0.0)
    position = recording.measured_position_m
    if position is None:
        motion = Motion.from_speed(time_s, speed, float(recording.position_m[0]))
        position = np.asarray(motion.position_m)
    return Motion(time_s, with_backlash(position, backlash_m) if backlash_m else position, speed)


def noise_of(
    recording: Recording, depth_m: float, causes: Mapping[str, Noise] | None = None
) -> SampleNoise:
    """The noise of stretches that the fact `quiet_s` names, or else white noise at the level of
    wavenumbers that the skin does not transmit, and coloured causes. Raises `BadInput` where there
    is none."""
    if recording.sidecar.get("quiet_s"):
        return quiet_noise(recording, mains_of(recording), causes)
    # Where the motion is fastest: a frequency above the cut-off there is above it everywhere.
    fastest = float(np.max(np.abs(recording.speed_m_per_s)))
    given = recording.signal, depth_m, fastest / recording.sample_rate_hz
    levels = white_levels(*given)
    refuse(
        not bool((levels > 0).all()),
        f"{recording.name}: the signal is constant or rounded, so its noise cannot be "
        "estimated: give noise.white.rms=... in the signal's unit.",
    )
    stderr = float(np.hypot(LEVEL_STDERR, level_stderr(*given)))
    return SampleNoise(levels, causes, is_estimate=True, level_stderr=stderr)
