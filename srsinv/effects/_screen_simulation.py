"""Screening of a simulation's effects, each scene once: a result is reused while all that it rests
on is the same."""

from collections import OrderedDict
from collections.abc import Mapping, Set
from dataclasses import replace

import numpy as np

from ..forward.simulation import Simulation
from ._effect import Effect, add_effects
from ._memory import Memory, content_key
from ._screen import ScreeningResult, screen
from ._signal_and_stress import signal_and_stress

MOST_HELD = 128  # results of a few kilobytes: all scenes of a study at all its tolerances

_RESULTS = Memory[ScreeningResult](MOST_HELD)


def screen_effects(
    sim: Simulation, effects: Mapping[str, Effect], tolerance: float
) -> tuple[Simulation, ScreeningResult]:
    """A simulation without effects, with those alone that its scene calls for; and what was found
    of each. One that the skin defines already is no effect to decide on.

    A result is reused while the simulation, the effects and the tolerance are the same.
    """
    whole = sim.scenario
    # All parts but the noise, which screening does without.
    without_noise = (
        whole.scene, whole.sensor, whole.scan, whole.recorder, sim.line, sim.fine, sim.refinement,
    )  # fmt: skip
    key = content_key((without_noise, OrderedDict(effects), tolerance))
    held = _RESULTS.get(key, lambda: _screened(sim, effects, tolerance))
    # A caller's own mappings, so that none can change what is held.
    bounds, times = dict(held.relative_change_bounds), dict(held.times_s)
    screening = replace(held, relative_change_bounds=bounds, times_s=times)
    return _with_effects(sim, effects, screening.on), screening


def forget_screenings() -> None:
    """Forget what [`screen_effects`][] has found so far: the next one weighs every effect anew."""
    _RESULTS.clear()


def _with_effects(sim: Simulation, effects: Mapping[str, Effect], names: Set[str]) -> Simulation:
    named = {name: effect for name, effect in effects.items() if name in names}
    return replace(sim, scenario=add_effects(sim.scenario, named))


def _screened(sim: Simulation, effects: Mapping[str, Effect], tolerance: float) -> ScreeningResult:
    ideal = sim.with_noises(())
    addable = {name: e for name, e in effects.items() if not e.is_defined_in(ideal.scenario)}

    def simulated(names: Set[str]) -> tuple[np.ndarray, np.ndarray]:
        return signal_and_stress(_with_effects(ideal, addable, names))

    return screen(ideal.scenario, ideal.fine, addable, tolerance, simulated)
