"""Many runs in one process, a thousand in `make claims`: no memory kept, nothing compiled anew,
nothing that is no number.

A run is a scene simulated from its configuration, with noise, and inverted; the general fit has its
turn too. Every number of the configuration changes after a few runs, which differ in their noise;
what is compiled belongs to shapes and to choices.
"""

import gc
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

import srsinv
from srsinv import config, parts
from srsinv.__main__ import find_config_root
from srsinv.forward.feature import LineFeature
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.simulated import noisy_problem

EACH = 16  # runs of the same numbers with other noise
COMPILED = "/jax/core/compile/backend_compile_duration"
GRID = ("grid.cells=32", "grid.refinement=2", "grid.length_m=0.012", "grid.start_m=-0.006")
# (name, what is special, overrides)
SCENES = {
    "strip": ("two elements, spectral path", "method=[wiener]"),
    "ridge": ("contact", "scene=ridge method=[wiener]"),
    "rough": ("contact, another texture each time", "scene=rough method=[wiener_paper]"),
    "tape": (
        "layers, converters",
        "scene=tape method=[wiener] "
        "effects=[strip_width,film_angle,layered_skin,quantisation,clipping]",
    ),
    "open": ("open line, direct path", "scene=strip grid.line=open method=[wiener]"),
    "chosen": ("a weight chosen", "scene=sinusoid amplifier=charge_dc method=[tikhonov]"),
    "single": (
        "likely scale, noise of three causes, in float32",
        "scene=hertz sensor=one_element friction=0.3 method=[wiener_evidence] precision=float32 "
        "noise=[johnson,sliding,white]",
    ),
}
# What sets a shape: how many there are of something.
COUNTS = {"cells", "refinement", "bits", "strips", "order"}
# Scenes; the runs, which end with the scene of the last warm one; the warm ones, in which every
# scene has had its turn; and what memory may grow by after these: in 1024 runs 20 kB for each, less
# than any compiled program takes. In `make test-all` are scenes with a kind of program that no
# other has.
FEWER = ("rough", "tape", "open", "single")
RUNS = (
    pytest.param(FEWER, 176, 96, 11 * 2**20, id="176"),
    pytest.param(tuple(SCENES), 1024, 128, 16 * 2**20, id="1024", marks=pytest.mark.claim),
)
FITTED = np.linspace(0.0, 1.0, 24)


class Compilations:
    """The programs compiled since the last look."""

    def __init__(self):
        self.names = []
        jax.monitoring.register_event_duration_secs_listener(self._note)

    def _note(self, event, duration, **about):
        del duration
        if event == COMPILED:
            self.names.append(about.get("fun_name", "one"))

    def taken(self) -> list[str]:
        names, self.names = self.names, []
        return names


@pytest.fixture
def compilations():
    counter = Compilations()
    yield counter
    jax.monitoring.unregister_event_duration_listener(counter._note)


def configuration(overrides: str) -> dict[str, Any]:
    with initialize_config_dir(str(find_config_root()), version_base="1.3"):
        cfg = compose("config", [*GRID, *overrides.split()])
    resolved = OmegaConf.to_container(cfg, resolve=True)
    assert isinstance(resolved, dict)
    return {str(key): value for key, value in resolved.items()}


def changed(node: Any, random: np.random.Generator, key: str = "") -> Any:
    """Every number within 3 % of what it is; seeds anew."""
    if isinstance(node, Mapping):
        return {name: changed(value, random, name) for name, value in node.items()}
    if isinstance(node, list):
        return [changed(value, random, key) for value in node]
    if key == "seed":
        return int(random.integers(1000))
    if not isinstance(node, int | float) or isinstance(node, bool) or key in COUNTS:
        return node
    return node * float(random.uniform(0.97, 1.0 if key == "poisson_ratio" else 1.03))


def inverting(cfg: Mapping[str, Any]) -> Callable[[int], list[np.ndarray]]:
    """What every method finds of a simulated signal, by the noise's seed."""
    with config.precision(cfg):
        sim, methods = config.simulation(cfg), config.methods(cfg).values()

    def inverted(seed: int) -> list[np.ndarray]:
        with config.precision(cfg):
            problem = noisy_problem(sim, jax.random.key(seed), config.friction(cfg))
            estimates = [method(problem) for method in methods]
            return [
                np.asarray(v) for each in estimates for v in (each.value, each.stderr, each.fitted)
            ]

    return inverted


def decay(params):
    """A model of the general fit."""
    return params["height"] * jnp.exp(-params["rate"] * FITTED) + params["rest"]


def fitted(seed: int) -> list[np.ndarray]:
    """What the general fit finds: other data, starts, bounds, priors and noise each time."""
    random = np.random.default_rng(seed)
    height, rate, rest, sigma, most = random.uniform(0.9, 1.1, 5) * (2.0, 3.0, 0.5, 0.01, 50.0)
    y = height * np.exp(-rate * FITTED) + rest + sigma * random.normal(size=FITTED.size)
    fit = srsinv.fit(
        decay,
        {"height": 0.9 * height, "rate": 0.8 * rate, "rest": 0.0},
        y,
        noise=sigma,
        bounds={"rate": (0.1 * rate, most)},
        priors={"rest": (0.9 * rest, rest)},
    )
    assert fit.converged
    ratio = np.array(fit.ratio("height", "rate"))
    return [*(np.array(list(tree.values())) for tree in (fit.value, fit.stderr)), ratio]


def resident_bytes() -> int:
    """Memory held by this process."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def live_arrays() -> int:
    """Their number, without those of the few effects that are remembered by their settings."""
    parts._effect_of_package.cache_clear()
    gc.collect()
    return len(jax.live_arrays())


needs_statm = pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="needs Linux's /proc"
)


@needs_statm
@pytest.mark.parametrize(("names", "runs", "warm", "most_growth"), RUNS)
def test_many_runs(compilations, margin, names, runs, warm, most_growth):
    """Memory stays, and nothing is compiled after the first run of each scene."""
    random = np.random.default_rng(0)
    scenes = {name: configuration(SCENES[name][1]) for name in names}
    # As in a new process, and with numbers of which no earlier test has left a result: what is
    # remembered of others would leave programs out that new numbers need.
    jax.clear_caches()
    new = np.random.default_rng(1)
    for cfg in scenes.values():
        inverting(cfg)(0)
        inverting(changed(cfg, new))(0)
    fitted(0)
    compilations.taken()
    turns = [*scenes, "fit"]
    held, arrays, work = 0, 0, fitted
    for run in range(runs):
        if run == warm:
            held, arrays = resident_bytes(), live_arrays()
        name = turns[run // EACH % len(turns)]
        if run % EACH == 0:
            work = fitted if name == "fit" else inverting(changed(scenes[name], random))
        outputs = work(run)
        assert all(np.isfinite(values).all() for values in outputs), (name, run)
        assert not (again := compilations.taken()), (name, run, again)
    margin(resident_bytes() - held, most_growth)
    assert resident_bytes() - held < most_growth
    assert live_arrays() <= arrays


def test_a_count_of_compilations(compilations):
    """What is compiled is seen: a number that is part of a program is compiled anew."""
    for factor in (0.25, 0.5):
        jax.jit(lambda x, factor=factor: x * factor)(np.ones(3))
    assert len(compilations.taken()) == 2


def test_a_feature_is_compiled_once(compilations):
    """Its signal, whatever its numbers, the strip's width and where it would be looked for."""

    def signal(i):
        film = Film(7.5e-4, effects=(StripAverage.at_depth(7e-4 + 2e-5 * i, 7.5e-4),))
        motion = Motion.from_speed(np.arange(40) / 500, 0.06, 1e-5 * i)
        feature = LineFeature(position_range_m=[-1e-3, 1e-3 + 1e-5 * i])
        model = FeatureModel.along(Sensor([film]), motion, float(film.depth_m) / 8).with_features(
            {"line": feature}
        )
        own = {"position_m": 2e-3, "load_N_per_m": 10.0 + i, "shear_N_per_m": -2.0}
        return np.asarray(model({"line": own}))

    assert np.isfinite(signal(0)).all()
    assert compilations.taken()
    for i in range(1, 4):
        assert np.isfinite(signal(i)).all()
        assert not compilations.taken()
