"""Settings of the fit of a recording: which features and starts it takes."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from ..errors import check_name, echo, mapping, number, refuse, whole
from ..forward.surface_feature import SurfaceFeature
from ..inverse.features.contact import checked_pressure
from ..inverse.features.loading import Features
from ..inverse.features.method import FeatureFit
from ..inverse.nonlinear import LEAST_DRAWS, Solver, check_sampler
from ..inverse.problem import Problem

RIG_KEYS = ("hold", "free", "select", "start")


def settings_of(given: Mapping[str, Any]) -> Mapping[str, Any]:
    """Those of `fit` in the configuration, checked, with what it leaves out."""
    known = {"select": False, "free": None, "start": None, "samples": 0}
    unknown = sorted(set(given) - set(known))
    refuse(
        bool(unknown), f"fit has no key {unknown and unknown[0]!r}: choose from {', '.join(known)}."
    )
    select = given.get("select", False)
    refuse(not isinstance(select, bool), f"fit.select is {echo(select)}: give true or false.")
    samples, least = given.get("samples", 0), LEAST_DRAWS
    if samples != 0 or isinstance(samples, bool):
        wanted = f"0, or the draws of each chain, a whole number from {least}"
        samples = whole("fit.samples", samples, wanted, least=least)
        check_sampler()  # before minutes of fitting
    return known | dict(given) | {"samples": samples}


def traction_fit(features: Features, solver: Solver, settings: Mapping[str, Any]) -> FeatureFit:
    """The fit of features of traction; refuses settings that it does not take."""
    for key in ("free", "start"):
        refuse(
            bool(settings[key]),
            f"fit.{key} is {echo(settings[key])}, but it is only for features of a "
            "surface (ridge, tape, step_up, step_down, cylinder): leave it out.",
        )
    return FeatureFit(features, solver)


def surface_fit(
    problem: Problem,
    facts: Mapping[str, Any],
    features: Features,
    solver: Solver,
    settings: Mapping[str, Any],
) -> FeatureFit:
    """The fit of features of a surface, with the edges of the sidecar's `facts`. Raises `BadInput`
    where what it needs to know of the recording is missing, and for settings that it does not
    take."""
    checked_pressure(problem.nominal_pressure_Pa)
    features = {name: with_edge(name, each, facts) for name, each in features.items()}
    free = names_of("fit.free", settings["free"])
    start = {} if settings["start"] is None else dict(mapping("fit.start", settings["start"]))
    several = len(features) > 1
    own = [f"{n}_{a}" if several else a for n, f in features.items() for a in f.reported]
    for name, value in start.items():
        check_name("fit.start", name, own)
        number(f"fit.start.{name}", value, "a number, in SI units, or leave it out")
    return FeatureFit(features, solver, free, start)


def with_edge(name: str, feature: SurfaceFeature, facts: Mapping[str, Any]) -> SurfaceFeature:
    """The feature with the edge length of the sidecar's `facts`, where it has none of its own;
    raises `BadInput` where neither is known."""
    if feature.edge_length_m is not None or not feature.has_edges:
        return feature
    known = (facts.get("feature") or {}).get("edge_length_m")
    refuse(
        known is None,
        f"The edge length of {name} is not known, and the data do not determine it "
        f"beside the width: give feature.{name}.edge_length_m, or "
        "feature.edge_length_m in the sidecar.",
    )
    return feature.with_edge(known)


class HeldFeature(NamedTuple):
    """A feature that a rig is measured on, by its name in the configuration."""

    name: str
    feature: Any

    def with_edge(self, facts: Mapping[str, Any]) -> Any:
        """The feature, one of a surface with an edge length that is known: see `with_edge`."""
        if not self.feature.is_of_surface:
            return self.feature
        return with_edge(self.name, self.feature, facts)


def known_feature(features: Features) -> HeldFeature:
    """The only one of the features that the configuration names."""
    refuse(
        len(features) != 1,
        f"feature names {len(features)} features: give one that is known, as feature=ridge.",
    )
    ((name, feature),) = features.items()
    return HeldFeature(name, feature)


def rig_settings(given: Mapping[str, Any]) -> Mapping[str, Any]:
    """Those of `fit` for a rig over a known feature: what is held, and what is free."""
    unknown = sorted(set(given) - set(RIG_KEYS))
    refuse(bool(unknown), f"fit has no key {unknown and unknown[0]!r}: choose from hold and free.")
    for key in ("select", "start"):
        refuse(
            bool(given.get(key)),
            f"fit.{key} is {echo(given.get(key))}, but a known feature takes only "
            "fit.hold and fit.free: leave it out.",
        )
    held = {} if given.get("hold") is None else mapping("fit.hold", given["hold"])
    free = given.get("free")
    return {"hold": dict(held), "free": None if free is None else names_of("fit.free", free)}


def names_of(key: str, given: Any) -> tuple[str, ...]:
    """Parameters' names, one or a list of them, as `key` of the configuration gives them."""
    listed = [] if given is None else [given] if isinstance(given, str) else given
    right = isinstance(listed, list | tuple) and all(isinstance(each, str) for each in listed)
    refuse(not right, f"{key} is {echo(given)}: give a list of parameters' names.")
    return tuple(listed)
