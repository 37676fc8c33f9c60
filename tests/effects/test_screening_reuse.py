"""A screening is reused while all that it rests on is the same, and only then."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv import config
from srsinv.effects import Effect, forget_screenings, screen_effects
from srsinv.effects.film_angle import FilmAngle
from srsinv.forward.noise import SignalToNoise
from srsinv.forward.scan import ConstantSpeed
from tests.effects.test_effects import configuration

FEW = (
    "effects=[strip_width,element_offsets,film_angle,layered_skin,amplifier_bandwidth,quantisation]"
)
TOLERANCE = 1e-3


class Counted(Effect):
    """One that changes nothing, and counts how often it is weighed."""

    scale: Any = 1.0
    weighed: ClassVar[list[int]] = []

    def apply(self, scenario):
        return scenario

    def relative_change_bound(self, reference):
        self.weighed.append(1)
        return 0.0


class Labelled(Counted):
    """One with a setting that cannot be compared."""

    labels: list = eqx.field(static=True, default_factory=list)


@pytest.fixture(autouse=True)
def afresh():
    forget_screenings()
    Counted.weighed.clear()


def case(scene: str = "strip", *settings: str):
    """A simulation without effects, and effects to decide on."""
    cfg = configuration(FEW, f"scene={scene}", *settings)
    sim = config.simulation(config.select_effects(cfg, ()))
    return sim, {**config.effects(cfg), "counted": Counted()}


def weighed(*asked) -> bool:
    before = len(Counted.weighed)
    screen_effects(*asked)
    return len(Counted.weighed) > before


@pytest.mark.full
def test_the_same_scene_is_weighed_once():
    """Made anew from the same configuration, and with other noise, which keeps to its scene."""
    sim, effects = case()
    first, result = screen_effects(sim, effects, TOLERANCE)
    again, _ = case()
    loud = again.with_noises((SignalToNoise(20.0),))
    assert not weighed(again, effects, TOLERANCE)
    noisy, reused = screen_effects(loud, effects, TOLERANCE)
    assert reused == result
    assert eqx.tree_equal(noisy.with_noises(()), first)
    assert len(noisy.scenario.noises) == 1


def nudged(leaf: Any) -> Any:
    """The next number."""
    array = np.asarray(leaf)
    return jnp.asarray(np.nextafter(array, array.dtype.type(np.inf)), array.dtype)


@pytest.mark.full
def test_any_other_number_is_weighed_anew():
    sim, effects = case()
    assert weighed(sim, effects, TOLERANCE)
    leaves, structure = jax.tree.flatten((sim, effects))
    for at, leaf in enumerate(leaves):
        others = [*leaves[:at], nudged(leaf), *leaves[at + 1 :]]
        assert weighed(*structure.unflatten(others), TOLERANCE), at
    assert weighed(sim, effects, np.nextafter(TOLERANCE, 1.0))
    assert not weighed(sim, effects, TOLERANCE)


ALTERED: dict[str, Callable[[Any, Any], tuple[Any, Any]]] = {
    "a setting that is static": lambda sim, effects: (
        replace(sim, refinement=1, fine=sim.line), effects,
    ),
    "one effect less": lambda sim, effects: (
        sim, {name: each for name, each in effects.items() if name != "quantisation"},
    ),
    "another order": lambda sim, effects: (sim, dict(reversed(effects.items()))),
    "another name": lambda sim, effects: (
        sim, {("own" if name == "film_angle" else name): each for name, each in effects.items()},
    ),
    "another part": lambda sim, effects: (
        replace(sim, scenario=sim.scenario.replace(scene=case("sinusoid")[0].scene)), effects,
    ),
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("alter", ALTERED.values(), ids=ALTERED)
def test_other_parts_are_weighed_anew(alter):
    sim, effects = case()
    screen_effects(sim, effects, TOLERANCE)
    assert weighed(*alter(sim, effects), TOLERANCE)


@pytest.mark.parametrize("own", [Labelled(), Counted(object())], ids=["static", "no number"])
def test_what_cannot_be_compared_is_weighed_every_time(own):
    sim, effects = case()
    asked = sim, {**effects, "counted": own}, TOLERANCE
    assert weighed(*asked)
    assert weighed(*asked)


def test_a_caller_cannot_change_what_is_held():
    sim, effects = case()
    result = screen_effects(sim, effects, TOLERANCE)[1]
    bounds: Any = result.relative_change_bounds
    bounds["strip_width"] = -1.0
    reused = screen_effects(sim, effects, TOLERANCE)[1]
    assert reused.relative_change_bounds["strip_width"] > 0


@pytest.mark.full
def test_a_reused_screening_is_that_found_afresh():
    """Over random numbers, asked in turn and more than once: as with nothing held."""
    rng, (sim, effects) = np.random.default_rng(0), case()

    def asked():
        scan = ConstantSpeed(rng.choice([0.02, 0.05, 0.2]))
        tilted = {**effects, "film_angle": FilmAngle(rng.choice([1e-3, 0.1, 2.0]))}
        moved = replace(sim, scenario=sim.scenario.replace(scan=scan))
        return (moved, tilted), float(rng.choice([0.1, 0.01, 0.001]))

    draws = [asked() for _ in range(24)]
    reused = [screen_effects(*scene, tolerance)[1] for scene, tolerance in draws]
    assert len(Counted.weighed) < 2 * len(draws)
    for (scene, tolerance), held in zip(draws, reused, strict=True):
        forget_screenings()
        result = screen_effects(*scene, tolerance)[1]
        assert (held.on, held.bound) == (result.on, result.bound)
        assert held.relative_change_bounds == result.relative_change_bounds
