"""The experiments on what the paper says beside its figures: their numbers, pages and refusals."""

from typing import Any

import numpy as np
import pytest

from srsinv.errors import BadInput
from tests.golden.check import golden_test
from tests.jobs.run import check_page, short_outcome, short_run
from tests.tiers import quick

FORMS = ("amplifier_drift", "element_array", "scan_speed", "skin_design")

test_nothing_has_moved = golden_test(FORMS)


@pytest.mark.full
@pytest.mark.parametrize("name", FORMS)
def test_page_is_whole(name):
    check_page(short_run(name))


@pytest.mark.full
def test_a_current_amplifier_shows_the_rate_of_warming():
    metrics: dict[str, Any] = dict(short_run("amplifier_drift").metrics)
    rate = 6**1.5 / (2 * np.sqrt(np.pi)) * np.exp(-1.5) * 1e-7 / 0.75e-3**2
    expected = 1e6 * 3e-5 * (2 * 0.5e-3 * 8e-3) * rate
    assert metrics["peak_warming_current_V"] == pytest.approx(expected, rel=1e-3)
    assert metrics["peak_bias_current_V"] == pytest.approx(1e-6, rel=1e-9)
    assert metrics["saturation_current_s"] is None
    # Bias and the whole pyroelectric charge on the capacitance reach the full scale.
    at, charge = metrics["saturation_charge_s"], 10.0 * 1e-10
    warm = 3e-5 * 8e-6 * (1 - 0.75e-3 / np.sqrt(np.pi * 1e-7 * at))
    assert 1e-12 * at == pytest.approx(charge - warm, rel=2e-2)


@pytest.mark.full
def test_samples_of_an_array_show_the_grating_at_the_pitch_stated():
    data = short_run("element_array").dataset
    for pitch, shown in zip(data["pitch"].values, data["apparent_grating"].values, strict=True):
        samples = np.cos(2 * np.pi * np.arange(3000) * pitch / 1.5e-3)
        per_m = np.fft.rfftfreq(samples.size, pitch)[np.abs(np.fft.rfft(samples)).argmax()]
        assert per_m == pytest.approx(1 / shown, abs=1e-9)
    assert np.all(np.diff(data["aliased_share"].values, axis=0) >= 0)
    assert data["aliased_share_scan"] == 0


@pytest.mark.full
def test_best_speed_is_where_noise_that_grows_meets_that_of_the_resistor():
    """On rubber that hardly relaxes the signal goes with u; of u^2/(a u + b u^3) the best is at
    sqrt(a/b)."""
    own = "effects.viscoelastic_skin.fractions=[1e-6,1e-6]", "scan_speed.points=33"
    result = short_outcome("scan_speed", *own, "scan_speed.sliding_fraction=0.03")
    data, metrics = result.dataset, dict(result.metrics)
    assert metrics["signal_exponent"] == pytest.approx(1, abs=1e-4)
    johnson = 4 * 1.380649e-23 * 300 * 1e6 / 5e-4
    sliding = data["sliding_rms"].sel(noise="bursts_that_grow_too").values ** 2
    best = np.sqrt(johnson / np.mean(sliding / data["speed"].values ** 3))
    assert 0.012 < best < 0.08
    found = metrics["best_speed_bursts_that_grow_too_m_per_s"]
    assert found == pytest.approx(best, rel=0.04)  # half a step of the speeds
    assert metrics["best_speed_fraction_of_signal_m_per_s"] == pytest.approx(0.1)


@pytest.mark.full
def test_lag_is_the_angle_of_the_complex_modulus():
    data = short_run("scan_speed").dataset
    omega = 2 * np.pi * data["speed"].values[:, None] / data["wavelength"].values
    turn = 1j * omega[..., None] * np.array([1e-3, 1e-2])
    angle = np.angle(1 + 0.5 * np.sum(turn / (1 + turn), axis=-1))
    np.testing.assert_allclose(data["lag_angle"], np.rad2deg(angle), rtol=1e-9)
    length = angle / (2 * np.pi) * data["wavelength"].values
    np.testing.assert_allclose(data["lag"], length, rtol=1e-9)


@pytest.mark.full
def test_foam_keeps_the_load_and_a_hard_layer_concentrates_it():
    metrics: dict[str, Any] = dict(short_run("skin_design").metrics)
    assert 100 * metrics["load_change_foam"] < metrics["load_change_plastic"]
    assert metrics["signal_change_foam"] < 0.02 < metrics["signal_change_plastic"]
    assert 50 * metrics["vibration_as_ridge_plastic_m"] < metrics["vibration_as_ridge_foam_m"]
    assert metrics["given_load_sigma_z_at_ratio_10"] < 1 < 2 < metrics["contact_stress_at_ratio_10"]
    assert metrics["contact_stress_at_ratio_10"] < metrics["contact_pressure_at_ratio_10"]


@pytest.mark.full
def test_a_stiff_strip_has_the_stress_of_half_a_width_and_the_shape_of_the_theory():
    """pi a/(4 t), less 3 % by the free surface and the film's own strain."""
    metrics: dict[str, Any] = dict(short_run("skin_design").metrics)
    rigid = np.pi * 0.25e-3 / (4 * 2 * 28e-6)
    assert metrics["strip_stress_ratio"] == pytest.approx(rigid, rel=0.03)
    assert metrics["similarity_to_theory_stiff_strip"] > 0.999


REFUSED = [
    ("amplifier_drift", "sensor=two_element", "has 2 elements"),
    ("amplifier_drift", "amplifier_drift.circuits.charge.capacitance_F=0", "charge.capacitance_F"),
    ("amplifier_drift", "amplifier_drift.circuits=null", "circuits is"),
    ("amplifier_drift", "amplifier_drift.duration_s=-1", "duration_s is"),
    ("scan_speed", "effects=[strip_width]", "skin is elastic"),
    ("scan_speed", "amplifier=charge_dc", "amplifier=current"),
    ("scan_speed", "scan_speed.noise_growth=null", "noise_growth is"),
    ("scan_speed", "scan_speed.temperature_K=0", "temperature_K is"),
    ("skin_design", "skin.poisson_ratio=0.3", "skin.poisson_ratio=0.5"),
    ("skin_design", "amplifier=charge_dc", "amplifier=current"),
    ("skin_design", "sensor.elements.along.angle_deg=90", "lies flat"),
    ("skin_design", "skin_design.backings=null", "backings is"),
    ("skin_design", "skin_design.film.thickness_m=0", "film.thickness_m"),
    ("element_array", "grid.line=open", "grid.line=periodic"),
    ("element_array", "element_array.share=1", "share is 1"),
    ("element_array", "element_array.pitches_m=[0]", "pitches_m"),
]


@pytest.mark.parametrize(("name", "override", "words"), quick(REFUSED, REFUSED[0]))
def test_refused(name, override, words):
    with pytest.raises(BadInput, match=words):
        short_outcome(name, *override.split())
