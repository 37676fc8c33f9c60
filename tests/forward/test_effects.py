"""Effects: what is not named leaves no trace, and what is bounded is never more than its bound."""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

import srsinv
from srsinv.__main__ import find_config_root
from srsinv.errors import BadInput
from srsinv.forward.contact import press
from srsinv.forward.effects import NAMES
from srsinv.forward.effects._contact import pressure_under
from srsinv.forward.effects._decide import decide
from srsinv.forward.effects._glance import _pressure, glance
from srsinv.forward.film import Film, StripWidth
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.jobs import build
from srsinv.jobs.change import difference, felt, pair, with_only
from srsinv.jobs.simulation import Simulation, decided, simulation

SMALL = ("grid.cells=256", "grid.refinement=2", "noise=[]")
KEY = jax.random.key(0)


def configuration(*overrides: str) -> dict:
    with initialize_config_dir(str(find_config_root()), version_base="1.3"):
        whole = OmegaConf.to_container(compose("config", [*SMALL, *overrides]), resolve=True)
    assert isinstance(whole, dict)
    return {str(key): value for key, value in whole.items()}


def signal(sim: Simulation):
    return sim.fine.operator(sim.sensor.signal(sim.scan))(sim.traction(sim.fine))


def lowered(*overrides: str) -> str:
    """The program of the signal that a configuration asks for."""
    return eqx.filter_jit(signal).lower(simulation(configuration(*overrides))).as_text()


def digest(*overrides: str) -> str:
    return hashlib.sha256(lowered(*overrides).encode()).hexdigest()


# --- off costs nothing ------------------------------------------------------------------------

SCENES = {
    "nothing": ("effects=[]",),
    "one": ("effects=[strip_width]",),
    "surface": ("effects=[strip_width]", "scene=ridge"),
    "open": ("effects=[film_angle]", "grid.line=open"),
}


def test_every_module_has_its_configuration():
    files = {path.stem for path in (find_config_root() / "effects").glob("*.yaml")}
    assert files == {*NAMES, "auto"}


def test_what_is_not_named_leaves_no_trace(tmp_path):
    """Byte for byte the program of a copy of the package in which no other effect exists."""
    package = Path(srsinv.__file__).parent
    copy = tmp_path / "srsinv"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))
    named = {"strip_width", "film_angle"}
    for name in set(NAMES) - named:
        (copy / "forward" / "effects" / f"{name}.py").unlink()
    for name in ("layered", "viscoelastic", "oblique", "circular", "snap_back"):
        (copy / "forward" / f"{name}.py").unlink()
    shutil.copytree(find_config_root(), tmp_path / "configs")
    shutil.copytree(Path(__file__).parents[1], tmp_path / "tests")
    script = (
        "import jax; jax.config.update('jax_enable_x64', True)\n"
        "import tests.forward.test_effects as here\n"
        "for one in here.SCENES.values(): print(here.digest(*one))\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, text=True, capture_output=True, check=False,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert found.returncode == 0, found.stderr[-2000:]
    assert found.stdout.split() == [digest(*one) for one in SCENES.values()]


def test_a_named_effect_is_no_more_than_its_module():
    """The program of the sensor put together by hand."""
    sim = simulation(configuration("effects=[strip_width]"))
    width = StripWidth.at_depth(0.7e-3, 0.75e-3)
    films = [Film(angle_rad=angle, effects=(width,)) for angle in (0.0, np.pi / 2)]
    by_hand = eqx.tree_at(lambda s: s.setup.sensor, sim, Sensor(films))
    texts = [eqx.filter_jit(signal).lower(each).as_text() for each in (sim, by_hand)]
    assert texts[0] == texts[1]
    assert lowered("effects=[]") != texts[0]


# --- what an effect changes -------------------------------------------------------------------

# Small ones and large ones, by name: settings of the effect and of the scene that it acts in.
ACTING = {
    "strip_width": ((), ("sensor.elements.along.strip_width_m=0.0001",)),
    "element_offsets": (("sensor.elements.upright.offset_m=1e-5",),),
    "film_angle": (("effects.film_angle.tilt_deg=0.1",), ("effects.film_angle.tilt_deg=10",)),
    "layered_skin": ((), ("effects.layered_skin.layers.skin.thickness_m=0.006",)),
    "viscoelastic_skin": (("scene=ridge",), ()),
    "oblique_features": (("effects.oblique_features.angle_deg=2",),),
    "amplifier_bandwidth": (("effects.amplifier_bandwidth.capacitance_F=1e-11",),),
    "antialias_filter": ((), ("effects.antialias_filter.cutoff_hz=5000",)),
    "sampling": ((),),
    "quantisation": (("effects.quantisation.full_scale=1e-4",), ("effects.quantisation.bits=16",)),
    "clipping": (("effects.clipping.limit=2e-5",), ("effects.clipping.limit=1",)),
    "speed_ripple": ((), ("effects.speed_ripple.fraction=0.001",)),
    "standstill": ((), ("effects.standstill.duration_s=0",)),
    "reversal": ((),),
    "load_drift": ((), ("effects.load_drift.fraction=0.001",)),
    "snap_back": ((),),
}
CASES = [(name, settings) for name, several in ACTING.items() for settings in several]


def test_every_effect_is_tried():
    assert set(ACTING) == set(NAMES)


@pytest.mark.parametrize(("name", "settings"), CASES, ids=str)
def test_it_changes_no_more_than_its_bound(name, settings):
    cfg = configuration(f"effects=[{name}]", *settings)
    there, bare = simulation(cfg), simulation(with_only(cfg, ()))
    share = build.effects(cfg)[name].share(glance(bare.setup, bare.line))
    felt = pair(there, bare, KEY)
    assert np.isfinite(felt[0].signal).all()
    # The look is on cells twice as wide.
    assert difference(*felt) <= 1.05 * share
    # Nor is every effect called for whatever the scene.
    assert share < 1e-3 or difference(*felt) > share / 40


@pytest.mark.parametrize("name", ["ridge", "tape", "rough"])
def test_a_look_presses_as_contact_does(name):
    """To a hundredth of the pressure's deviation behind the rubber over the film, |k| e^(-kz); a
    profile that touches everywhere to round-off."""
    sim = simulation(configuration("effects=[]", f"scene={name}"))
    k = np.asarray(sim.line.k)
    felt = k * np.exp(-k * 0.75e-3)
    looked, solved = (
        np.fft.rfft(each)
        for each in (_pressure(sim.scene, sim.line, k), sim.scene.pressure(sim.line))
    )
    off = np.linalg.norm(felt * (looked - solved)) / np.linalg.norm(felt * solved)
    assert off < (1e-2 if np.any(sim.scene.pressure(sim.line) == 0) else 1e-9)


def test_a_look_presses_grazing_profiles():
    """Spikes of one cell, of which next to nothing touches; the load is kept."""
    sim = simulation(configuration("effects=[]", "scene=ridge"))
    k, height = np.asarray(sim.line.k), np.zeros(sim.line.n)
    height[[40, 90]] = 1e-4, 2e-4
    compliance = np.append(0.0, 2 / (9.3e5 * k[1:]))
    for load in (1e-6, 1.0, 1e3):
        p = pressure_under(height, load, compliance)
        solved = press(sim.line, HalfSpace(), jnp.asarray(height), load).pressure_Pa
        assert p.mean() == pytest.approx(load, rel=1e-12)
        assert np.all(p >= 0)
        assert np.abs(p - solved).max() < 0.05 * p.max()


LOUD = {
    "strip_width": "sensor.elements.along.strip_width_m=0.0007",
    "film_angle": "effects.film_angle.tilt_deg=1",
    "layered_skin": "effects.layered_skin.layers.skin.thickness_m=0.002",
    "antialias_filter": "effects.antialias_filter.cutoff_hz=500",
    "clipping": "effects.clipping.limit=5e-5",
}


@pytest.mark.parametrize(("name", "setting"), LOUD.items(), ids=LOUD)
def test_nor_beside_loud_bursts(name, setting):
    """Which pass the film, the skin and the filters, and go beyond rails that the signal keeps."""
    cfg = configuration(f"effects=[{name},snap_back]", "effects.snap_back.shear_Pa=5000", setting)
    both, loud, bare = (
        simulation(with_only(cfg, on)) for on in ((name, "snap_back"), ("snap_back",), ())
    )
    with_it, without = pair(both, loud, KEY)
    assert difference(pair(both, bare, KEY)[1], with_it) > 0.5
    verdicts = decide(bare.setup, bare.line, build.effects(cfg), 1e-3)
    share = {verdict.name: verdict.share for verdict in verdicts}
    assert 1e-3 < difference(without, with_it) <= share[name]


def test_what_is_left_out_stays_within_the_tolerance():
    cfg = configuration("effects=auto", "effects.film_angle.tilt_deg=0.01",
                        "effects.speed_ripple.fraction=1e-4", "effects.load_drift.fraction=1e-4",
                        "effects.standstill.duration_s=0", "effects.reversal.duration_s=0",
                        "effects.quantisation.bits=20", "effects.clipping.limit=1",
                        "effects.oblique_features.angle_deg=0")  # fmt: skip
    cfg.pop("tolerance")
    full, counts = simulation(cfg), []
    for tolerance in (0.2, 1e-2, 1e-4):
        _, verdicts = decided({**cfg, "tolerance": tolerance})
        assert sum(v.share for v in verdicts if not v.on) <= tolerance
        on = {v.name for v in verdicts if v.on}
        counts.append(len(on))
        assert difference(*reversed(pair(full, simulation(with_only(cfg, on)), KEY))) < tolerance
    assert 0 < counts[0] < counts[1] < counts[2] < len(NAMES)


SOFT = "effects.layered_skin.layers.skin.youngs_modulus_Pa=3e4"
STIFF = "effects.layered_skin.layers.skin.youngs_modulus_Pa=7e7"
ALTERED = {
    "levels too coarse for a soft skin's signal": (
        "layered_skin,quantisation", "scene=ridge", SOFT, "effects.quantisation.bits=12",
        "effects.quantisation.full_scale=1e-3"),
    "bursts louder than a soft skin's signal": (
        "layered_skin,snap_back", "scene=ridge", SOFT, "effects.snap_back.shear_Pa=10"),
    "rails that only a stiff skin reaches": (
        "layered_skin,clipping", "scene=ridge", STIFF, "effects.clipping.limit=4.6e-4"),
    "rails that only a raised load reaches": (
        "load_drift,clipping", "scene=sinusoid", "effects.load_drift.fraction=0.9",
        "effects.load_drift.period_s=2", "effects.clipping.limit=3.6e-5"),
}  # fmt: skip


@pytest.mark.parametrize("case", ALTERED.values(), ids=ALTERED)
def test_what_stays_on_is_in_the_signal_that_the_rest_is_weighed_by(case):
    names, *settings = case
    cfg = configuration(f"effects=[{names}]", *settings)
    full = simulation(cfg)
    for tolerance in (0.1, 0.003):
        kept, verdicts = decided({**cfg, "tolerance": tolerance})
        less, whole = reversed(pair(full, simulation(kept), KEY))
        assert difference(less, whole) < tolerance
    # The large one is on, and called for the other, by itself far below.
    assert {v.name for v in verdicts if v.on} == set(names.split(","))


def test_filters_come_before_the_sampling():
    """Samples taken seldom are every seventh of those taken often, whatever passes half their rate;
    the finer line's cells, met 640 times a second, ask for seven times the slow rate."""
    common = ("effects=[sampling,antialias_filter,speed_ripple]", "scene=ridge",
              "effects.antialias_filter.cutoff_hz=120")  # fmt: skip
    often, seldom = (
        felt(simulation(configuration(*common, f"effects.sampling.rate_hz={rate}")), KEY)
        for rate in (700, 100)
    )
    n = min(seldom.time_s.size, often.time_s[::7].size)
    np.testing.assert_allclose(seldom.time_s[:n], often.time_s[::7][:n], rtol=1e-12)
    off = np.abs(seldom.signal[:, :n] - often.signal[:, ::7][:, :n]).max()
    assert off < 1e-9 * np.abs(often.signal).max()


# --- refusals ---------------------------------------------------------------------------------

REFUSED = {
    "unknown": ({"nope": {}}, "no effect 'nope'"),
    "settings alone": ({"film_angle": {"tilt_deg": 1}}, "film_angle is not among the effects"),
    "layers": (("layered_skin", {"layers": {}}), "give a list of layers"),
    "layer": (("layered_skin", {"layers": [{"thickness_m": 1e-3}]}), "lacks poisson_ratio"),
    "terms": (("viscoelastic_skin", {"fractions": [1.0]}), "1 fractions and 2 times_s"),
    "tilt": (("film_angle", {"tilt_deg": "steep"}), "give an angle in degrees"),
    "rate": (("sampling", {"rate_hz": 0}), "give a positive rate"),
    "angle": (("oblique_features", {"angle_deg": 91}), "from -90 to 90"),
    "core": (("layered_skin", {"layers": [{"thickness_m": 5e-4, "youngs_modulus_Pa": 7e5,
                                           "poisson_ratio": 0.5}]}), "rigid core"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "sentence"), REFUSED.values(), ids=REFUSED)
def test_what_no_effect_can_be(change, sentence):
    if isinstance(change, tuple):
        name, settings = change
        cfg = configuration(f"effects=[{name}]")
        cfg["effects"][name] |= settings
    else:
        cfg = configuration("effects=[]") | {"effects": change}
    with pytest.raises(BadInput, match=sentence):
        build.setup(cfg)


def test_a_job_of_the_sensor_alone_refuses_what_acts_elsewhere():
    cfg = configuration("effects=[load_drift]")
    with pytest.raises(BadInput, match=r"effects names load_drift.*leave it out"):
        build.sensor(cfg)


def test_sliding_along_the_features_is_silent():
    cfg = configuration("effects=[oblique_features]", "effects.oblique_features.angle_deg=90")
    setup = build.setup(cfg)
    line = build.line(cfg)
    felt = line.operator(setup.sensor.signal(setup.scan))(jnp.ones((2, line.n)).at[0, 3].set(5.0))
    np.testing.assert_array_equal(felt, 0.0)
