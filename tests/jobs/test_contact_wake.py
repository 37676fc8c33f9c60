"""What a job says of a contact that meets its own wake."""

import pytest

from srsinv.report.terminal import print_summary
from tests.jobs.run import outcome, words

CYLINDER = (
    "scene=ridge",
    "~scene.surfaces.ridge",
    "+surface@scene.surfaces.cylinder=cylinder",
    "scene.nominal_pressure_Pa=3000",
    "effects=[viscoelastic_skin]",
    "effects.viscoelastic_skin.fractions=[1.0]",
    "effects.viscoelastic_skin.times_s=[0.2]",  # at 0.05 m/s: 2 cm of wake
    "grid.cells=64",
    "method=[wiener]",
)


@pytest.mark.full
def test_a_window_that_is_given_too_short_is_said_everywhere(capsys):
    result = outcome(*CYLINDER, "scene.contact_windows=1")
    assert result.metrics["quality_wiener"] != "good"
    print_summary(result)
    for said in (str(result.metrics["warnings_wiener"]), words(result), capsys.readouterr().out):
        assert "its own wake" in said


@pytest.mark.full
def test_a_window_that_is_left_open_is_long_enough():
    assert "wake" not in str(outcome(*CYLINDER).metrics["warnings_wiener"])
