"""The experiments on the rig of a vibrating edge: their numbers, pages and refusals."""

import numpy as np
import pytest
from scipy.optimize import brentq

from srsinv.errors import BadInput
from tests.golden.check import golden_test
from tests.jobs.run import check_page, short_outcome, short_run
from tests.tiers import quick

FORMS = ("fig08_knife_edge", "frequency_response", "linearity")

test_nothing_has_moved = golden_test(FORMS)

HALF_SPACE = ("effects=[strip_width]",)
CORELESS = "effects=[strip_width] linearity.controls=[displacement]"
LINE_LOAD = "frequency_response.radius_m=0 frequency_response.drives=[displacement]"


@pytest.mark.full
@pytest.mark.parametrize("name", FORMS)
def test_page_is_whole(name):
    check_page(short_run(name))


@pytest.mark.full
def test_the_curve_is_that_of_sliding_and_of_the_line_load():
    """Without effects in the skin the rig is theory, but for the edge's radius."""
    own = "sensor.depth_m=0.001", "fig08_knife_edge.directions_deg=[-45,0,30]", "noise=[]"
    result = short_outcome("fig08_knife_edge", *HALF_SPACE, *own)
    for angle in (-45, 0, 30):
        assert result.metrics[f"mirror_error_{angle}_deg"] < 1e-6
        assert result.metrics[f"fitted_amplitude_{angle}_deg"] == pytest.approx(1, abs=1e-3)
        assert result.metrics[f"fit_residual_{angle}_deg"] < 1e-3
    phase = result.dataset["measured_phase"].values
    assert np.all((np.abs(phase) < 1e-6) | (np.abs(phase - 180) < 1e-6))
    at = result.metrics["sign_change_theory_0_deg_m"]
    before, after = np.interp([at - 2.5e-4, at + 2.5e-4], result.dataset["place"], phase[1])
    assert abs(before) < 1e-6 < 179 < after


@pytest.mark.full
def test_layers_differ_from_the_half_space():
    metrics = short_run("fig08_knife_edge").metrics
    assert metrics["mirror_error_45_deg"] < 1e-6
    assert 0.1 < metrics["fit_residual_without_noise_0_deg"] < metrics["fit_residual_0_deg"] < 0.5


@pytest.mark.full
def test_slopes_and_phases():
    result = short_run("frequency_response")
    metrics, octave = result.metrics, 20 * np.log10(2)
    assert metrics["slope_nothing_named_dB_per_octave"] == pytest.approx(octave, abs=1e-9)
    assert metrics["phase_nothing_named_at_first_deg"] == pytest.approx(90, abs=1e-9)
    assert metrics["slope_sampling_dB_per_octave"] == pytest.approx(octave, abs=1e-9)
    lag = np.rad2deg(np.arctan(2 * np.pi * 1000 * 1e-3))
    assert metrics["phase_amplifier_bandwidth_at_last_deg"] == pytest.approx(90 - lag, abs=1e-6)
    turn = 2j * np.pi * np.array([10.0, 1000.0])[:, None] * np.array([1e-3, 1e-2])
    stiffer = np.abs(1 + 0.5 * np.sum(turn / (1 + turn), axis=1))
    more = 20 * np.log10(stiffer[1] / stiffer[0]) / np.log2(100)
    assert metrics["slope_drive_displacement_dB_per_octave"] == pytest.approx(
        octave + more, abs=1e-9
    )
    assert metrics["slope_drive_acceleration_dB_per_octave"] == pytest.approx(
        more - octave, abs=1e-9
    )
    assert result.dataset["apparent_frequency"].values[-1] == pytest.approx(200)


@pytest.mark.full
def test_the_edge_that_leaves_the_skin():
    """A line load given by a sine, F >= 0: with c = preload/amplitude the first harmonic is
    1/2 + (asin c + c sqrt(1 - c^2))/pi of it, and proportional up to the preload."""
    own = "linearity.radii_m=[0]", "linearity.controls=[load]", "linearity.amplitude_range=[0.01,8]"
    result = short_outcome("linearity", *HALF_SPACE, *own)
    amplitude = result.dataset["amplitude"].values
    c = np.minimum(1 / amplitude, 1)
    expected = 0.5 + (np.arcsin(c) + c * np.sqrt(1 - c**2)) / np.pi
    level = result.dataset["deviation"].values[0, 0]
    np.testing.assert_allclose(level, 20 * np.log10(expected), atol=1e-5)
    assert result.metrics["deviation_load_at_0_m_dB"] < 1e-9
    at = result.metrics["amplitude_at_3_dB_load_at_0_m"]
    left = brentq(lambda c: np.arcsin(c) + c * np.sqrt(1 - c**2) - np.pi * (10**-0.15 - 0.5), 0, 1)
    assert at == pytest.approx(1 / left, rel=1e-6)


@pytest.mark.full
def test_the_paper_s_3_dB_hold_for_both_controls():
    metrics = short_run("linearity").metrics
    by_load, by_displacement = (
        metrics[f"deviation_{each}_at_0.005_m_dB"] for each in ("load", "displacement")
    )
    assert 0 < by_load < 0.01 < by_displacement < 3


REFUSED = [
    ("linearity", CORELESS, "a skin on a rigid core"),
    ("frequency_response", LINE_LOAD, "without limit"),
    ("linearity", "effects=[speed_ripple]", "speed_ripple, which acts on sliding"),
    ("frequency_response", "effects=auto", "effects=auto"),
    ("frequency_response", "frequency_response.drives=[force]", "drives is 'force'"),
    ("frequency_response", "amplifier=integrated", "IntegratedCurrent integrates along x"),
    ("fig08_knife_edge", "noise=[sliding]", "correlated along x"),
    ("fig08_knife_edge", "sensor=two_element", "has 2 elements"),
    ("fig08_knife_edge", "fig08_knife_edge.amplitude_N_per_m=2", "leave the skin"),
    ("fig08_knife_edge", "fig08_knife_edge.directions_deg=[100]", "100.0|100: give angles"),
    ("fig08_knife_edge", "fig08_knife_edge.place_range_m=[1,0]", "in increasing order"),
    ("fig08_knife_edge", "fig08_knife_edge.widths_m=[]", "widths_m is"),
    ("linearity", "linearity.controls=[load,work]", "controls is 'work'"),
    ("linearity", "linearity.radii_m=[-1]", "radii_m"),
    ("linearity", "linearity.amplitude_range=[2,3]", "leaves the skin"),
]


@pytest.mark.parametrize(("name", "override", "words"), quick(REFUSED, *REFUSED[::7]))
def test_refused(name, override, words):
    with pytest.raises(BadInput, match=words):
        short_outcome(name, *override.split())
