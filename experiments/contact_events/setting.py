"""The episode, noise and templates of the experiment, from its settings."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from srsinv.errors import echo, number, numbers, refuse, whole
from srsinv.forward.episode import Episode, PassingEdge, Ramp, RecordedEpisode, slip_noise
from srsinv.forward.partial_slip import CylinderContact, check_similar
from srsinv.forward.scenario import Scenario
from srsinv.forward.surface import StepDown, StepUp
from srsinv.forward.vibration import noise_rms_at_rest
from srsinv.inverse.events.matched import DetectedEvent
from srsinv.inverse.events.templates import EventTemplate, event_templates
from srsinv.inverse.events.whitening import ORDER, StreamWhitener

POSITIVE = {
    "durations_s": "positive times in seconds", "drops_s": "positive times in seconds",
    "step_heights_m": "positive heights in metres", "strengths": "positive strengths d'",
    "speeds_m_per_s": "positive speeds in m/s",
}  # fmt: skip


class EventSetting:
    """What happens, and what the detectors know of it.

    `given`: the settings within their bounds; `sensor`; `episode`: that happens.
    """

    def __init__(self, given: Mapping[str, Any], scenario: Scenario, episode: Episode):
        self.given, self.sensor, self.episode = given, scenario.sensor, episode
        self.recorded = RecordedEpisode(episode, scenario.sensor)
        self.noises = scenario.noises

    @classmethod
    def checked(cls, name: str, settings: Mapping[str, Any], scenario: Scenario) -> "EventSetting":
        """Raises `BadInput` for settings out of their bounds."""
        given = dict(settings)

        def positive(key: str, wanted: str) -> float:
            return float(number(f"{name}.{key}", given[key], wanted, above=0))

        given["sample_rate_hz"] = positive("sample_rate_hz", "a positive rate in Hz")
        wanted = "a whole number from 100 to 1000000"
        whole(f"{name}.samples", given["samples"], wanted, least=100, most=1_000_000)
        whole(f"{name}.draws", given["draws"], "a whole number from 10", least=10, most=100_000)
        for key, wanted in POSITIVE.items():
            given[key] = numbers(f"{name}.{key}", given[key], wanted, above=0)
        wanted = "numbers above 0 and below 1"
        given["shear_ratios"] = numbers(
            f"{name}.shear_ratios", given["shear_ratios"], wanted, above=0, below=1
        )
        positive("step_height_m", "a positive height in metres")
        positive("sliding_correlation_m", "a positive length in metres")
        wanted = "a number in V, at least 0"
        number(f"{name}.sliding_noise_V", given["sliding_noise_V"], wanted, least=0)
        rows = [_three(name, given, key) for key in ("start_s", "duration_s", "exponent")]
        touch, pull, release = (Ramp(*each) for each in zip(*rows, strict=True))
        edge = PassingEdge(
            StepUp(given["step_height_m"], 0.0), given["edge_s"], given["speed_m_per_s"]
        )
        episode = Episode(
            CylinderContact(given["radius_m"], given["place_m"]), given["load_N_per_m"],
            touch, pull, edge, release, given["friction"], given["sliding_friction"],
            given["drop_s"],
        )  # fmt: skip
        least = int(np.ceil(release.end_s * given["sample_rate_hz"])) + 1
        refuse(
            given["samples"] < least,
            f"{name}.samples is {given['samples']}, and the load has left after {release.end_s:g} "
            f"s: give at least {least}.",
        )
        check_similar(scenario.sensor.skin)
        rms = noise_rms_at_rest(scenario.noises, given["sample_rate_hz"], 1.0)
        refuse(rms <= 0, "There is no noise, so every event is detected: give noise=[johnson].")
        return cls(given, scenario, episode)

    @cached_property
    def clean(self) -> Float[np.ndarray, "e sample"]:
        """The signal without noise [V]."""
        return self.recorded.signal(self.given["sample_rate_hz"], self.given["samples"])

    @cached_property
    def onsets_s(self) -> dict[str, float]:
        """When each event begins [s]."""
        return self.recorded.onsets_s

    @cached_property
    def noise_rms_V(self) -> float:
        """White noise of a sample [V rms]."""
        signal_rms = float(np.sqrt(np.mean(self.clean**2)))
        return noise_rms_at_rest(self.noises, self.given["sample_rate_hz"], signal_rms)

    @cached_property
    def correlation_samples(self) -> float:
        """Correlation of the noise of sliding, in samples."""
        given = self.given
        length = given["sliding_correlation_m"] / given["speed_m_per_s"]
        return length * given["sample_rate_hz"]

    def noisy(self, key: PRNGKeyArray) -> Float[np.ndarray, "e sample"]:
        """The recorded signal [V], with noise of the amplifier and of full slip."""
        of_white, of_slip = jax.random.split(key)
        white = np.asarray(jax.random.normal(of_white, self.clean.shape), float)
        time = np.arange(self.clean.shape[-1]) / self.given["sample_rate_hz"]
        slips = self.episode.forces(time).slips
        added = slip_noise(
            of_slip, slips, self.given["sliding_noise_V"], self.correlation_samples, len(white)
        )
        return self.clean + self.noise_rms_V * white + added

    @cached_property
    def whitener(self) -> StreamWhitener:
        """Of the noise in full slip, which is the loudest."""
        elements, slow = len(self.clean), self.given["sliding_noise_V"]
        if slow == 0:
            return StreamWhitener.white([self.noise_rms_V] * elements)
        lag = np.arange(ORDER + 1)
        covariance = slow**2 * np.exp(-lag / self.correlation_samples)
        covariance[0] += self.noise_rms_V**2
        return StreamWhitener.of_covariance(np.stack([covariance] * elements))

    @cached_property
    def templates(self) -> tuple[EventTemplate, ...]:
        """Those of the nominal finger."""
        given = self.given
        nominal = Episode(
            CylinderContact(given["nominal_radius_m"], given["place_m"]),
            given["nominal_load_N_per_m"],
            Ramp(0.0, 1.0),
        )
        edges = [step(h, 0.0) for h in given["step_heights_m"] for step in (StepUp, StepDown)]
        return event_templates(
            nominal, self.sensor, given["sample_rate_hz"], given["durations_s"],
            given["drops_s"], edges, given["speeds_m_per_s"],
        )  # fmt: skip

    @property
    def facts(self) -> dict[str, Any]:
        """What the page says of the setting, in SI units."""
        scalar = {key: value for key, value in self.given.items() if np.isscalar(value)}
        half = self.episode.contact.half_width_m(self.sensor.skin, self.episode.load_N_per_m)
        return scalar | {
            "half_width_m": float(half),
            "noise_rms_V": self.noise_rms_V,
            "skin": self.sensor.skin.words,
            "depth_m": float(self.sensor.depth_m),
            "elements": len(self.sensor.elements),
            "templates": len(self.templates),
        }


def _three(name: str, given: Mapping[str, Any], key: str) -> list[float]:
    values = given[key]
    refuse(
        not isinstance(values, list) or len(values) != 3,
        f"{name}.{key} is {echo(values)}: give three numbers, of touch, pull and release.",
    )
    return values


def listed_events(
    onsets_s: Mapping[str, float], events: Sequence[DetectedEvent]
) -> dict[str, tuple[np.ndarray, str]]:
    """The detected events in a table, each with the true one that began last before its middle."""
    kinds, begun = list(onsets_s), np.array(list(onsets_s.values()))
    middles = [event.onset_s + event.duration_s / 2 for event in events]
    nearest = [int(np.searchsorted(begun, middle, "right")) - 1 for middle in middles]
    truth = [kinds[at] if at >= 0 else "none" for at in nearest]
    return {
        "answer": (np.array([event.answer for event in events], str), "1"),
        "likeliest": (np.array([event.kind for event in events], str), "1"),
        "truth": (np.array(truth, str), "1"),
        "found_onset": (np.array([event.onset_s for event in events]), "s"),
        "alarm": (np.array([event.alarm_s for event in events]), "s"),
        "reported": (np.array([event.reported_s for event in events]), "s"),
        "found_strength": (np.array([event.strength for event in events]), "1"),
        "probability": (np.array([each.probability[each.kind] for each in events]), "1"),
        "false_alarm": (np.array([event.false_alarm for event in events]), "1"),
    }
