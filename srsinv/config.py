"""The composed configuration becomes objects here: one builder for each part.

`cfg` is read by these builders and in the `run` of a job or an experiment, nowhere else. All of
them raise `BadInput` for parts that cannot be made. None imports jax before it makes a part of an
array: the command refuses what it can without.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from . import parts
from .errors import choice, echo, mapping, number, refuse, whole
from .targets import TARGET, make

if TYPE_CHECKING:  # most import jax
    from pathlib import Path

    import jax

    from .effects import Effect, ScreeningResult
    from .forward.feature import Feature
    from .forward.noise import Noise
    from .forward.scan import ConstantSpeed
    from .forward.scenario import Scenario
    from .forward.scene import Scene
    from .forward.sensor import Sensor
    from .forward.simulation import Simulation
    from .forward.surface_feature import SurfaceFeature
    from .grid import Line
    from .inverse.kernel.operator_model import OperatorModel
    from .inverse.method import Method
    from .inverse.nonlinear import Solver
    from .inverse.problem import Problem
    from .recording import Reader, Recording
    from .recording.known_passes import CalibrationPasses
    from .report.section import Section

Config = Mapping[str, Any]
PRECISIONS = ("float64", "float32")
NAMED = ("effects", "feature", "method", "noise", "section")  # groups of options by name
FIGURES = ("page", "all", "none")  # of those of a page, the ones that are drawn


def check_early(cfg: Config) -> None:
    """Refuse, before any heavy import, scalars that are invalid in every job, and a recording whose
    file, sidecar or stated facts cannot be read."""
    if "seed" in cfg:
        seed(cfg)
    if "precision" in cfg:
        precision_name(cfg)
    if "figures" in cfg:
        choice("figures", cfg["figures"], FIGURES)
    if "tolerance" in cfg:
        tolerance(cfg)
    settings = cfg.get("recording")
    if isinstance(settings, Mapping) and settings.get("path") is not None:
        refuse(
            set(settings) == {"path"},  # as recording=none has it
            "recording.path is given, but this job reads no recording: give a job that "
            "does, such as experiment=inspect_recording, invert_recording or "
            "fit_recording.",
        )
        from .recording import check_settings

        check_settings(settings, reader(cfg))
    if "bands" in cfg:
        known_passes(cfg)


def part(cfg: Config, name: str) -> Mapping[str, Any]:
    """The mapping `cfg[name]`; null means an empty one. Raises `BadInput` for anything else, and
    for a group of named options of which one has no name."""
    node = cfg.get(name)
    node = {} if node is None else mapping(name, node)
    refuse(
        name in NAMED and TARGET in node,
        f"An option of {name} has no name: begin its file {name}/NAME.yaml with the line "
        f"'# @package {name}.NAME'.",
    )
    return node


def select_effects(cfg: Config, names: Collection[str]) -> Config:
    """The configuration with these of its effects."""
    named = part(cfg, "effects").items()
    return {**cfg, "effects": {name: node for name, node in named if name in names}}


def with_facts(cfg: Config, sensor: Mapping[str, Any], skin: Mapping[str, Any]) -> Config:
    """The configuration, with these facts of the sensor and of a half space where it leaves keys of
    its sensor, amplifier and skin open."""
    return {**cfg, **parts.with_facts(_sensor_nodes(cfg), sensor, skin)}


def _sensor_nodes(cfg: Config) -> dict[str, Any]:
    return {name: part(cfg, name) for name in ("sensor", "skin", "amplifier")}


def seed(cfg: Config) -> int:
    """Seed of all random numbers."""
    return whole("seed", cfg["seed"], "a whole number from 0 to 2147483647", least=0)


def tolerance(cfg: Config) -> float:
    """The relative change of the signal that `effects=auto` may leave out."""
    wanted = "a fraction of the signal's rms, above 0 and below 1"
    return number("tolerance", cfg["tolerance"], wanted, above=0, below=1)


def random_key(cfg: Config) -> jax.Array:
    """The key of all random numbers."""
    import jax

    return jax.random.key(seed(cfg))


def precision_name(cfg: Config) -> str:
    """The word for the working precision."""
    name = cfg["precision"]
    refuse(name not in PRECISIONS, f"precision is {echo(name)}: give float64 or float32.")
    return name


@contextmanager
def precision(cfg: Config) -> Iterator[None]:
    """Work in float64 or float32, by `cfg["precision"]`."""
    import jax

    with jax.enable_x64(precision_name(cfg) == "float64"):
        yield


def line(cfg: Config, refinement: Any = 1) -> Line:
    """The line of `grid`, its cells `refinement` times finer at the same first position."""
    return parts.line(part(cfg, "grid"), refinement)


def friction(cfg: Config) -> float | None:
    """mu in q = mu p; None leaves p and q apart."""
    given = cfg["friction"]
    wanted = "a number, of either sign, or null for q independent of p"
    return None if given is None else float(number("friction", given, wanted))


def simulation(cfg: Config) -> Simulation:
    """The simulation with the named effects; with `effects=auto` those that its scene calls for."""
    return screened(cfg)[0]


def screened(cfg: Config) -> tuple[Simulation, ScreeningResult | None]:
    """The simulation, and what was found of each effect with `effects=auto`.

    Raises `BadInput` for a tolerance that is not between 0 and 1.
    """
    from .effects import screen_effects

    if "tolerance" not in cfg:
        return _simulation(cfg, scenario(cfg)), None
    without = _simulation(cfg, ideal(cfg).replace(noises=noises(cfg)))
    return screen_effects(without, effects(cfg), tolerance(cfg))


def _simulation(cfg: Config, scenario: Scenario) -> Simulation:
    from .forward.simulation import Simulation

    _check_signal(scenario, cfg["scan"]["speed_m_per_s"])
    times: Any = part(cfg, "grid").get("refinement")
    return Simulation(scenario, line(cfg), line(cfg, times), int(times))


def _check_signal(scenario: Scenario, speed_m_per_s: Any) -> None:
    """Refuse a sensor whose signal is zero whatever the traction."""
    along = scenario.scan.speed_m_per_s
    rests = "a static touch gives no rate signal, set it to a value other than 0"
    turned = "the sensor slides along the features, give a smaller oblique_features.angle_deg"
    refuse(
        float(scenario.sensor.amplifier.at_speed(along)) == 0.0,
        f"scan.speed_m_per_s is {speed_m_per_s}: {turned if speed_m_per_s else rests}.",
    )


def scenario(cfg: Config) -> Scenario:
    """The scenario, with the named effects."""
    from .effects import add_effects

    named = effects(cfg)
    return add_effects(ideal(cfg).replace(noises=noises(cfg)), named)


def ideal(cfg: Config) -> Scenario:
    """The scenario without noise and effects; without a scene where the job has none."""
    from .forward.scenario import Scenario

    motion, sensor = scan(cfg), _ideal_sensor(cfg)
    scene = parts.scene(part(cfg, "scene"), cfg["skin"]) if "scene" in cfg else None
    return Scenario(scene, sensor, motion).sliding()


def scene(cfg: Config) -> Scene:
    """The scene, for a job that takes effects of the sensor alone."""
    built = _sensor_scenario(cfg).scene
    assert built is not None
    return built


def sensor(cfg: Config) -> Sensor:
    """Film elements in their skin, read by the amplifier, for a job that takes effects of the
    sensor alone."""
    return _sensor_scenario(cfg).sensor


def _sensor_scenario(cfg: Config) -> Scenario:
    from .effects import add_effects

    return add_effects(ideal(cfg), sensor_effects(cfg))


def _ideal_sensor(cfg: Config) -> Sensor:
    return parts.sensor(part(cfg, "sensor"), cfg["skin"], part(cfg, "amplifier"))


def scan(cfg: Config) -> ConstantSpeed:
    """The scan at constant speed."""
    node = part(cfg, "scan")
    refuse(
        node.get("speed_m_per_s", 0) is None, "No speed is known: give scan.speed_m_per_s in m/s."
    )
    return make(node, "scan", "scan")


def noises(cfg: Config) -> tuple[Noise, ...]:
    """The named causes of noise."""
    return tuple(parts.noises(part(cfg, "noise")).values())


def effects(cfg: Config) -> dict[str, Effect]:
    """The named effects, in the order in which they are added."""
    return parts.effects(part(cfg, "effects"))


def sensor_effects(cfg: Config) -> dict[str, Effect]:
    """The named effects, which have to be of the sensor."""
    return parts.effects_of_sensor(_sensor_effect_nodes(cfg))


def _sensor_effect_nodes(cfg: Config) -> Mapping[str, Any]:
    refuse(
        "tolerance" in cfg,
        "effects=auto needs a simulated scene, which this job does not have: name "
        "the sensor's effects, as effects=[strip_width,layered_skin].",
    )
    return part(cfg, "effects")


def at_rest(cfg: Config) -> Scenario:
    """The scenario of a sensor at rest, with the named effects."""
    from .effects import add_effects

    refuse(
        "tolerance" in cfg,
        "effects=auto needs a sliding sensor, but this job's sensor is at rest: name "
        "its effects, as effects=[strip_width,layered_skin].",
    )
    named = parts.effects_at_rest(part(cfg, "effects"))
    return add_effects(ideal(cfg).replace(noises=noises(cfg)), named)


def reader(cfg: Config) -> Reader:
    """The reader of recorded files."""
    return make(cfg["reader"], "reader", "reader")


def recording(cfg: Config, default: str | None = None) -> Recording:
    """The recording at even times; that at the path `default` where none is named."""
    from .progress import say, stage
    from .recording.even import load_even

    settings = part(cfg, "recording")
    if default is not None:
        settings = {**settings, "path": settings.get("path") or default}
    known = {"sensor": {"elements": part(cfg, "sensor").get("elements")}}
    with stage(f"reading {settings.get('path')}"):
        recording = load_even(settings, known, reader(cfg))
    for note in recording.notes:
        say(f"{recording.name}: {note}")
    return recording


def known_passes(cfg: Config) -> CalibrationPasses | None:
    """The passes over known surfaces on which bands are calibrated; None where there are none."""
    from .recording.known_passes import CalibrationPasses

    return CalibrationPasses.of(part(cfg, "bands"))


def of_file(cfg: Config, path: Path) -> Config:
    """The configuration with another file in place of its recording, under the same settings."""
    return {**cfg, "recording": {**part(cfg, "recording"), "path": str(path)}}


def recorded_problem(
    cfg: Config,
    recording: Recording,
    is_wired_as_stated: bool = False,
    are_straight_across: bool = True,
) -> Problem:
    """The problem of finding what made a recording at even times, by the sensor that the sidecar
    and the configuration describe; the configuration overrides. `is_wired_as_stated`,
    `are_straight_across`: as `recorded.problem_of` takes them. Raises `BadInput` where facts are
    missing, and where numbers of elements and signal columns differ."""
    from .progress import stage
    from .recorded import problem_of, sensor_of

    cell_m, noise = part(cfg, "recording").get("cell_m"), part(cfg, "noise")
    if cell_m is not None:
        number("recording.cell_m", cell_m, "a positive width in metres", above=0)
    with stage(f"preparing {recording.name}"):
        return problem_of(
            recording,
            sensor_of(recording, {**_sensor_nodes(cfg), "effects": _sensor_effect_nodes(cfg)}),
            noise=parts.stated_white_rms(noise, recording),
            causes=parts.coloured_noises(noise),
            friction=friction(cfg) if "friction" in cfg else None,
            cell_m=cell_m,
            operator=operator(cfg),
            is_wired_as_stated=is_wired_as_stated,
            are_straight_across=are_straight_across,
        )


def streamed_problem(cfg: Config, recording: Recording) -> Problem:
    """The problem of the first rows of a stream, by the sensor that the sidecar and the
    configuration describe: what a live inversion knows before it begins."""
    from .inverse.noise.model import SampleNoise
    from .recorded import sensor_of, stated_problem

    rms = parts.stated_white_rms(part(cfg, "noise"), recording)
    nodes = {**_sensor_nodes(cfg), "effects": _sensor_effect_nodes(cfg)}
    noise = SampleNoise(1.0 if rms is None else rms, is_estimate=rms is None)
    return stated_problem(recording, sensor_of(recording, nodes), noise, friction(cfg))


def features(cfg: Config) -> dict[str, Feature]:
    """The named features of traction, to be fitted as a sum."""
    named = part(cfg, "feature")
    return {name: make(node, f"feature.{name}", "traction_feature") for name, node in named.items()}


def surface_features(cfg: Config) -> dict[str, SurfaceFeature]:
    """The named features of a surface, if any, to be fitted as a sum."""
    return parts.surface_features(part(cfg, "feature"))


def operator(cfg: Config) -> OperatorModel | None:
    """How a recording's operator is known; None where the job has theory alone."""
    return make(cfg["operator"], "operator", "operator") if "operator" in cfg else None


def solver(cfg: Config) -> Solver:
    """The solver of nonlinear fits."""
    return make(cfg["solver"], "solver", "solver")


def methods(cfg: Config) -> dict[str, Method]:
    """The methods by their labels on pages; in lower case, with underscores, they end the names of
    metrics. Raises `BadInput` for two of one label."""
    named = part(cfg, "method")
    refuse(not named, "No method is named: give method=[wiener,tikhonov] or one of them.")
    made: dict[str, Method] = {}
    for name, node in named.items():
        method = make(node, f"method.{name}", "method")
        label = _method_label(name, type(method))
        refuse(
            label.lower() in map(str.lower, made),
            f"Two methods have the label {label!r}: name the file of one, and its line "
            f"'# @package method.{name}', otherwise.",
        )
        made[label] = method
    return made


def _method_label(name: str, kind: type) -> str:
    """The words of a method's name; where they begin with its class's, that is written as the class
    is: `tv_strong` of a class TV is "TV strong"."""
    words, own = name.replace("_", " "), kind.__name__
    if f"{words} ".lower().startswith(f"{own} ".lower()):
        return own + words[len(own) :]
    return words[:1].upper() + words[1:]


def sections(cfg: Config) -> tuple[Section, ...]:
    """The sections that the page is to have beside those of its job."""
    named = part(cfg, "section").items()
    return tuple(make(node, f"section.{name}", "section") for name, node in named)
