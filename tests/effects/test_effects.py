"""Effects: what is not named leaves no trace, and what is bounded is never more than its bound."""

import math
import subprocess
import sys
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from srsinv import config
from srsinv.__main__ import find_config_root
from srsinv.effects import NAMES, Effect, reference, screen, screen_effects
from srsinv.effects.antialias_filter import AntialiasFilter
from srsinv.effects.general import FilmEffect, FilterEffect, SpeedProfileEffect
from srsinv.effects.speed_ripple import SpeedRipple
from srsinv.effects.strip_width import StripWidth
from srsinv.errors import BadInput
from srsinv.forward.film import Film, StripAverage
from srsinv.forward.filter import Butterworth, Filter
from srsinv.forward.recorder import Recorder
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scenario import Scenario
from srsinv.forward.sensor import Sensor
from srsinv.forward.simulation import Simulation
from srsinv.forward.speed_profile import RippleProfile
from srsinv.forward.trace import Trace, difference, pair, trace
from tests.tiers import quick

SMALL = ("grid.cells=128", "grid.refinement=2", "noise=[]")
KEY = jax.random.key(0)


def configuration(*overrides: str) -> dict:
    with initialize_config_dir(str(find_config_root()), version_base="1.3"):
        whole = OmegaConf.to_container(compose("config", [*SMALL, *overrides]), resolve=True)
    assert isinstance(whole, dict)
    return {str(key): value for key, value in whole.items()}


def signal(sim: Simulation):
    return sim.fine.operator(sim.sensor.output(sim.scan))(sim.traction(sim.fine))


def program(sim: Simulation) -> str:
    """Of the signal along the line and along a motion, as traced."""
    motion = Recorder().motion(sim.line, sim.fine, sim.scan)
    traction, sensor = sim.traction(sim.fine), sim.sensor
    ways = (
        eqx.filter_make_jaxpr(signal)(sim)[0],
        eqx.filter_make_jaxpr(lambda s: s.operator_along(sim.fine, motion)(traction))(sensor)[0],
    )
    return "\n".join(map(str, ways))


# --- off costs nothing ------------------------------------------------------------------------


def test_every_module_has_its_configuration():
    files = {path.stem for path in (find_config_root() / "effects").glob("*.yaml")}
    assert files == {*NAMES, "auto"}


@pytest.mark.full
def test_no_other_module_is_imported():
    script = (
        "import sys; from srsinv.targets import make\n"
        "import srsinv.jobs.simulate\n"
        "make({'limit': 1.0, '_target_': 'srsinv.effects.clipping.Clipping'}, "
        "'effects.clipping', 'effects')\n"
        "print(*(n.split('.')[-1] for n in sys.modules if n.startswith('srsinv.effects.')))"
    )
    process = subprocess.run([sys.executable, "-c", script], text=True, capture_output=True)
    assert process.returncode == 0, process.stderr[-2000:]
    assert {*process.stdout.split()} & {*NAMES} == {"clipping"}


@pytest.mark.parametrize("line", quick(["periodic", "open"], "open"))
def test_what_is_not_named_leaves_no_trace(line):
    """The program is that of a simulation put together by hand without it."""
    named = config.simulation(configuration("effects=[strip_width]", f"grid.line={line}"))
    none = config.simulation(configuration("effects=[]", f"grid.line={line}"))
    width = StripAverage.at_depth(0.7e-3, 0.75e-3)
    by_hand = [
        eqx.tree_at(
            lambda s: s.scenario,
            none,
            Scenario(none.scene, Sensor(films).with_films(Film.at_origin), ConstantSpeed(0.05)),
        )
        for films in (
            [Film(angle_rad=angle) for angle in (0.0, np.pi / 2)],
            [Film(angle_rad=angle, effects=(width,)) for angle in (0.0, np.pi / 2)],
        )
    ]
    programs = [program(each) for each in (none, named)]
    assert programs == [program(each) for each in by_hand]
    assert programs[0] != programs[1]
    assert none.scenario.recorder == Recorder()
    assert not none.scenario.noises


# --- what an effect changes -------------------------------------------------------------------

# Small ones and large ones, by name: settings of the effect and of the scene that it acts in.
ACTING = {
    "strip_width": ((), ("sensor.elements.along.strip_width_m=0.0001",)),
    "element_offsets": (("sensor.elements.upright.offset_m=1e-5",),),
    "film_angle": (("effects.film_angle.tilt_deg=0.1",), ("effects.film_angle.tilt_deg=10",)),
    "layered_skin": ((), ("effects.layered_skin.layers.skin.thickness_m=0.006",)),
    "viscoelastic_skin": (
        ("scene=ridge",), (), ("scene=ridge", "scene.base_friction=10.0"),
        # So far below its peak the compliance changes by its lag alone.
        ("scene=ridge", "effects.viscoelastic_skin.times_s=[1e-6,1e-5]"),
        # A skin that becomes so stiff loses touch between the ridges.
        ("scene=ridges", "effects.viscoelastic_skin.times_s=[1e-2,1e-2]",
         "effects.viscoelastic_skin.fractions=[5.0,5.0]"),
    ),
    "oblique_features": (("effects.oblique_features.angle_deg=2",),),
    "finite_patch": (
        ("effects.finite_patch.profile=hertz", "effects.finite_patch.half_width_m=0.15"),
        ("scene=ridge", "effects.finite_patch.half_width_m=0.003"),
        ("grid.line=open", "effects.finite_patch.profile=hertz"),
    ),
    "fingerprint": (
        ("scene=ridge",),
        ("effects.fingerprint.modulation=0.01", "effects.fingerprint.pitch_m=0.001"),
    ),
    "varying_friction": (
        ("scene=ridge",), (),
        ("amplifier=charge_dc", "effects.varying_friction.speed_exponent=0.1",
         "effects.varying_friction.reference_speed_m_per_s=0.01"),
    ),
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
}  # fmt: skip
# One case of each effect is in `make test-all`, by turns a large and a small one; of the
# viscoelastic skin all are, as they differ in kind.
CASES, OTHERS = [], []
for at, (name, several) in enumerate(ACTING.items()):
    chosen = range(len(several)) if name == "viscoelastic_skin" else {at % len(several)}
    for i, settings in enumerate(several):
        (CASES if i in chosen else OTHERS).append((name, settings))


class Repeated(Filter):
    """A filter with a count and a word."""

    time_scale_s: jax.Array
    times: int
    word: str
    poles = (-1.0,)

    def response(self, omega_rad_per_s, xp=jnp):
        assert self.word == "low"
        by_one = super().response(omega_rad_per_s, xp)
        return math.prod([by_one for _ in range(self.times)])


def test_a_filter_with_words_and_counts_is_screened():
    cfg = configuration("effects=[]")
    ideal = config.simulation(cfg)
    spectra = reference(ideal.scenario, ideal.fine)
    one, two = (
        FilterEffect(Repeated(jnp.asarray(1e-4), times, "low")).factor(spectra) for times in (1, 2)
    )
    np.testing.assert_allclose(two, one**2, rtol=1e-14)


def test_every_effect_is_tried():
    assert set(ACTING) == set(NAMES)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        *quick(CASES, *CASES[::16]),
        *(pytest.param(*other, marks=pytest.mark.claim) for other in OTHERS),
    ],
    ids=str,
)
def test_it_changes_no_more_than_its_bound(name, settings):
    cfg = configuration(f"effects=[{name}]", *settings)
    with_effect, ideal = config.simulation(cfg), config.simulation(config.select_effects(cfg, ()))
    bound = config.effects(cfg)[name].relative_change_bound(reference(ideal.scenario, ideal.fine))
    both = pair(with_effect, ideal, KEY)
    assert np.isfinite(both[0].signal).all()
    # Samples are at every second cell of the reference's.
    assert difference(*both) <= 1.02 * bound
    # Nor is every effect called for whatever the scene.
    assert bound < 1e-3 or difference(*both) > bound / 40


GENERAL = {
    "filter": (FilterEffect(Butterworth(200.0)), AntialiasFilter(200.0)),
    "film": (FilmEffect(StripAverage(0.7e-3)), StripWidth()),
    "speed_profile": (SpeedProfileEffect(RippleProfile(0.2, 10.0)), SpeedRipple(0.2, 10.0)),
}


@pytest.mark.full
@pytest.mark.parametrize("part", GENERAL)
def test_a_general_effect_is_the_one_of_a_name_with_the_same_part(part):
    general, named = GENERAL[part]
    whole = config.simulation(configuration("effects=[]"))
    both = [
        pair(replace(whole, scenario=each.apply(whole.scenario)), whole, KEY)[0].signal
        for each in GENERAL[part]
    ]
    np.testing.assert_allclose(*both, rtol=1e-12, atol=1e-12 * np.abs(both[0]).max())
    spectra = reference(whole.scenario, whole.fine)
    if general.is_exact:
        bound = named.relative_change_bound(spectra)
        assert general.relative_change_bound(spectra) == pytest.approx(bound, rel=1e-9)
    else:
        assert general.relative_change_bound(spectra) == np.inf


def test_signals_that_are_rounded_to_nothing_do_not_differ():
    nothing = Trace(np.arange(3.0), np.zeros((1, 3)))
    assert difference(nothing, nothing) == 0.0
    assert difference(nothing, nothing._replace(signal=np.ones((1, 3)))) == 1.0


# All in one program, at numbers at which they change nothing.
SILENT = (
    "effects=[element_offsets,film_angle,antialias_filter,clipping,snap_back]",
    "effects.snap_back.shear_Pa=5000", "sensor.elements.along.offset_m=1e-15",
    "effects.film_angle.tilt_deg=0", "effects.antialias_filter.cutoff_hz=1e15",
    "effects.clipping.limit=1e9",
)  # fmt: skip
LOUD = {
    "element_offsets": ("sensor.elements.along.offset_m=0.0001",),
    "film_angle": ("effects.film_angle.tilt_deg=1",),
    "antialias_filter": ("effects.antialias_filter.cutoff_hz=500",),
    "clipping": ("effects.clipping.limit=3.5e-5",),
}


@pytest.fixture(scope="module")
def silent():
    return trace(config.simulation(configuration(*SILENT)), KEY)


@pytest.mark.parametrize(("name", "settings"), quick(LOUD.items()), ids=LOUD)
def test_nor_beside_loud_bursts(name, settings, silent):
    """Which pass the film, the skin and the filters, and go beyond rails that the signal keeps."""
    cfg = configuration(*SILENT, *settings)
    change = difference(trace(config.simulation(cfg), KEY), silent)
    few = config.select_effects(cfg, (name, "snap_back"))
    screening = screen(config.ideal(few), config.line(few), config.effects(few), 1e-3)
    assert 1e-3 < change <= screening.relative_change_bounds[name]


@pytest.mark.full
def test_what_acts_at_a_film_is_bounded_within_a_narrow_zone():
    """There it is no factor on the signal, of which a wave of 8 mm has too little."""
    given = "scene=sinusoid", "grid.cells=256", "effects.finite_patch.half_width_m=5e-4"
    cfg = configuration("effects=[strip_width,finite_patch]", *given)
    zone = config.simulation(config.select_effects(cfg, ("finite_patch",)))
    change = difference(*pair(zone, config.simulation(cfg), KEY))
    effects = config.effects(cfg)
    screening = screen(config.ideal(cfg), config.line(cfg), effects, 1e-9)
    bound = screening.relative_change_bounds["strip_width"]
    spectra = reference(zone.scenario.replace(sensor=config.ideal(cfg).sensor), zone.fine)
    assert effects["strip_width"].relative_change_bound(spectra) < change <= bound < 2 * change


SOFT = "effects.layered_skin.layers.skin.youngs_modulus_Pa=3e4"
STIFF = "effects.layered_skin.layers.skin.youngs_modulus_Pa=7e7"
ALTERED = {
    "levels too coarse for a soft skin's signal": (
        "layered_skin,quantisation", "scene=ridge", SOFT, "effects.quantisation.bits=14",
        "effects.quantisation.full_scale=1e-3"),
    "bursts louder than a soft skin's signal": (
        "layered_skin,snap_back", "scene=ridge", SOFT, "effects.snap_back.shear_Pa=10"),
    "rails that only a stiff skin reaches": (
        "layered_skin,clipping", "scene=ridge", STIFF, "effects.clipping.limit=4.6e-4",
        "grid.cells=256"),
    "rails that only a raised load reaches": (
        "load_drift,clipping", "scene=sinusoid", "effects.load_drift.fraction=0.9",
        "effects.load_drift.period_s=2", "effects.clipping.limit=3.6e-5"),
}  # fmt: skip


@pytest.mark.parametrize("case", quick(ALTERED, "rails that only a raised load reaches"))
def test_what_stays_on_is_in_the_signal_that_the_rest_is_screened_by(case):
    names, *settings = ALTERED[case]
    cfg = configuration(f"effects=[{names}]", *settings)
    large, small = names.split(",")
    _, screening = config.screened({**cfg, "tolerance": 0.003})
    assert screening is not None
    assert screening.on == {large, small}
    # By itself the small one is far below.
    alone = config.select_effects(cfg, (small,))
    small_screening = screen(config.ideal(alone), config.line(alone), config.effects(alone), 0.003)
    assert not small_screening.on


SKINS = ("layered", "viscoelastic")


@pytest.mark.full
@pytest.mark.parametrize("name", SKINS)
def test_a_skin_is_the_effect_that_sets_it(name):
    by_skin, by_effect = (
        trace(config.simulation(configuration("scene=ridge", *given)), KEY).signal
        for given in ((f"skin={name}", "effects=[]"), (f"effects=[{name}_skin]",))
    )
    np.testing.assert_allclose(by_skin, by_effect, rtol=0, atol=1e-12 * np.abs(by_effect).max())


@pytest.mark.parametrize("skin", SKINS)
def test_skin_and_effect_together_are_refused(skin):
    for named in {f"{skin}_skin", "layered_skin"}:
        cfg = configuration(f"skin={skin}", f"effects=[{named}]")
        with pytest.raises(BadInput, match=rf"^effects names {named}, but skin defines one"):
            config.scenario(cfg)
        with pytest.raises(BadInput, match=rf"^effects names {named}, but skin defines one"):
            config.sensor(cfg)


@pytest.mark.full
def test_a_skin_that_is_defined_is_no_effect_to_decide_on():
    cfg = configuration("skin=layered", "effects=[layered_skin,viscoelastic_skin,strip_width]")
    _, screening = config.screened({**cfg, "tolerance": 1e-3})
    assert screening is not None
    assert screening.relative_change_bounds.keys() == {"viscoelastic_skin", "strip_width"}


def test_a_simulation_is_screened_as_its_configuration_is():
    cfg = configuration("effects=[strip_width,film_angle]", "effects.film_angle.tilt_deg=1e-3")
    by_keys, screening = config.screened({**cfg, "tolerance": 1e-3})
    without = config.simulation(config.select_effects(cfg, ()))
    by_objects, result = screen_effects(without, config.effects(cfg), 1e-3)
    assert screening is not None
    assert result.on == screening.on == {"strip_width"}
    assert eqx.tree_equal(by_objects, by_keys)


class Unbounded(Effect):
    """One of a user's own, that states no bound."""

    def apply(self, scenario):
        return scenario


def test_an_effect_without_a_bound_stays_on():
    """And the others are screened as they are without it."""
    cfg = configuration("effects=[strip_width,film_angle]", "effects.film_angle.tilt_deg=1e-3")
    given = config.ideal(cfg), config.line(cfg)
    own = {**config.effects(cfg), "own": Unbounded()}
    assert screen(*given, own, 1e-3).on == {"strip_width", "own"}


def test_what_is_left_out_adds_up():
    """As changes do, at most; with less allowed, the one that changes the most stays on."""
    cfg = configuration(
        "effects=[element_offsets,film_angle]", "sensor.elements.along.offset_m=1e-5",
        "effects.film_angle.tilt_deg=0.3",
    )  # fmt: skip
    scene = config.ideal(cfg), config.line(cfg), config.effects(cfg)
    none = screen(*scene, 1.0)
    bounds = none.relative_change_bounds
    assert not none.on
    assert none.bound >= sum(bounds.values()) > 1.3 * max(bounds.values())
    assert screen(*scene, 0.99 * none.bound).on == {max(bounds, key=lambda name: bounds[name])}


@pytest.mark.full
def test_beside_a_skin_that_raises_the_traction():
    """What another effect changes grows with the traction, which a stiff skin raises."""
    cfg = configuration(
        "effects=[layered_skin,viscoelastic_skin]", "scene=tape", STIFF,
        "effects.viscoelastic_skin.times_s=[1e-6,1e-5]",
    )  # fmt: skip
    layered = config.simulation(config.select_effects(cfg, ("layered_skin",)))
    change = difference(*pair(config.simulation(cfg), layered, KEY))
    _, screening = config.screened({**cfg, "tolerance": 0.1})
    assert screening is not None
    assert screening.on == {"layered_skin"}
    assert change <= screening.relative_change_bounds["viscoelastic_skin"]


@pytest.mark.full
def test_filters_come_before_the_sampling():
    """Samples taken seldom are every seventh of those taken often, whatever passes half their rate;
    the finer line's cells, met 320 times a second, ask for seven times the slow rate."""
    common = ("effects=[sampling,antialias_filter,speed_ripple]", "scene=ridge",
              "effects.antialias_filter.cutoff_hz=120")  # fmt: skip
    often, seldom = (
        trace(config.simulation(configuration(*common, f"effects.sampling.rate_hz={rate}")), KEY)
        for rate in (350, 50)
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


@pytest.mark.parametrize(
    ("change", "sentence"), quick(REFUSED.values(), *[*REFUSED.values()][::3]), ids=REFUSED
)
def test_what_no_effect_can_be(change, sentence):
    if isinstance(change, tuple):
        name, settings = change
        cfg = configuration(f"effects=[{name}]")
        cfg["effects"][name] |= settings
    else:
        cfg = configuration("effects=[]") | {"effects": change}
    with pytest.raises(BadInput, match=sentence):
        config.scenario(cfg)


def test_a_job_of_the_sensor_alone_refuses_what_acts_elsewhere():
    cfg = configuration("effects=[load_drift]")
    with pytest.raises(BadInput, match=r"effects names load_drift.*leave it out"):
        config.sensor(cfg)


@pytest.mark.full
def test_sliding_along_the_features_is_silent():
    cfg = configuration("effects=[oblique_features]", "effects.oblique_features.angle_deg=90")
    scenario = config.scenario(cfg)
    line = config.line(cfg)
    output = line.operator(scenario.sensor.output(scenario.scan))(
        jnp.ones((2, line.n)).at[0, 3].set(5.0)
    )
    np.testing.assert_array_equal(output, 0.0)
