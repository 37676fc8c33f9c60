"""Contact events: touch, partial and full slip, an edge and release, and how well each is found."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import xarray

from srsinv import config
from srsinv.forward.episode import KINDS_OF_EVENT
from srsinv.inverse.events.matched import EventDetector
from srsinv.inverse.events.threshold import ThresholdDetector
from srsinv.report.data import dataset, scalars
from srsinv.report.result import Result
from srsinv.report.section import sections

from .characteristics import FALSE_ALARMS_PER_S, Characteristics
from .figures import draw_episode, draw_operating, draw_shear, draw_signal
from .setting import EventSetting, listed_events
from .sticking import half_widths, tractions, zones

NAME = "contact_events"


def run(cfg: config.Config) -> Result:
    """An episode, its detections, and the operating characteristics of both detectors.

    Raises `BadInput` for a skin on which partial slip is not solved, noise that slides with the
    surface, and settings out of their bounds.
    """
    with config.precision(cfg):
        setting = EventSetting.checked(NAME, cfg[NAME], config.at_rest(cfg))
        given, episode, sensor = setting.given, setting.episode, setting.sensor
        for_noise, for_draws = jax.random.split(config.random_key(cfg))
        signal = setting.noisy(for_noise)
        whitener, rate = setting.whitener, given["sample_rate_hz"]
        stated = rate, given["false_alarms_per_s"]
        detector = EventDetector(setting.templates, whitener, *stated)
        events = [*detector.push(signal), *detector.finish()]
        simple = ThresholdDetector(whitener, *stated)
        alarms = [alarm.time_s for alarm in simple.push(signal)]
        found = Characteristics(setting, detector, simple, for_draws)
        curves = found.curves()
        widths = half_widths(sensor.skin, given)
        profile = tractions(sensor.skin, episode, given["shear_ratios"])
        time = np.arange(given["samples"]) / rate
        zone = zones(sensor.skin, episode, time)

        onsets = setting.onsets_s
    rows = listed_events(onsets, events)
    pairs = set(zip(rows["answer"][0], rows["truth"][0], strict=True))
    along = ("element", "time")
    data = dataset(
        {
            "signal": (along, signal, "V"),
            "contact_half_width": ("time", zone[0], "m"),
            "stick_half_width": ("time", zone[1], "m"),
            "pressure": ("x", profile[0], "Pa"),
            "shear": (("ratio", "x"), profile[1], "Pa"),
            "half_width_closed": ("ratio", widths[0], "1"),
            "half_width_solved": ("ratio", widths[1], "1", "stick_half_width_at_{ratio}"),
            "onset": ("kind", np.array(list(onsets.values())), "s"),
            **_of_curves(curves),
            **{name: ("event", values, unit) for name, (values, unit) in rows.items()},
            **scalars({
                "events": len(events), "threshold_alarms": len(alarms),
                "kinds_named": sum(pair[0] == pair[1] for pair in pairs),
                "limit": detector.limit, "threshold_limit": simple.limit,
                "greatest_half_width_error": float(np.abs(widths[1] - widths[0]).max()),
            }),
        },
        {"element": (np.arange(signal.shape[0]), "1"), "time": (time, "s"),
         "x": (profile[2], "m"), "ratio": (given["shear_ratios"], "1"),
         "kind": (list(KINDS_OF_EVENT), "1"), "strength": (given["strengths"], "1"),
         "rate": (FALSE_ALARMS_PER_S, "1/s"), "event": (np.arange(len(events)) + 1, "1")},
        **setting.facts,
    )  # fmt: skip
    drawn = sections(__file__, shear=draw_shear, episode=draw_episode, signal=draw_signal,
                     operating=draw_operating)  # fmt: skip
    return Result(_title(data), data, drawn)


def _of_curves(curves: Mapping[str, np.ndarray]) -> dict[str, tuple[Any, ...]]:
    """Detection and delay of each kind of event, and the operating characteristics."""
    by = ("kind", "strength", "rate")
    return {
        "natural_strength": ("kind", curves["natural"], "1", "strength_of_{kind}"),
        "delay": ("kind", curves["delay"], "s", "delay_of_{kind}_s"),
        "late_delay": ("kind", curves["late_delay"], "s", "delay_90_percent_of_{kind}_s"),
        "detected": ("kind", curves["detected"], "1", "detected_{kind}"),
        "threshold_delay": ("kind", curves["threshold_delay"], "s", "threshold_delay_of_{kind}_s"),
        "threshold_detected": (
            "kind", curves["threshold_detected"], "1", "threshold_detected_{kind}"
        ),
        "matched_operating": (by, curves["matched_operating"], "1"),
        "threshold_operating": (by, curves["threshold_operating"], "1"),
    }  # fmt: skip


def _title(data: xarray.Dataset) -> str:
    kinds, passed = int(data["kinds_named"]), int(np.sum(data["threshold_detected"] > 0.5))
    return (
        f"Matched filters name {kinds} of {data.sizes['kind']} contact events; a threshold detects "
        f"{passed} of them, at {data.attrs['false_alarms_per_s']:g} false alarms per second"
    )
