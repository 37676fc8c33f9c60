"""The recordings that come with the package."""

import numpy as np
import pytest

import srsinv
from srsinv import examples


@pytest.mark.parametrize("name", examples.names())
def test_each_is_read_with_its_sidecar_from_any_folder(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recording = srsinv.load(examples.path(name))
    assert recording.sidecar["sensor"]
    assert np.isfinite(recording.signal).all()
    truth = examples.truth(name)
    start_m, end_m = 0.0, float(np.trapezoid(recording.speed_m_per_s, recording.time_s))
    assert start_m < truth["position_m"] < end_m


def test_a_wrong_name_is_refused_with_the_nearest():
    for ask in (examples.path, examples.truth):
        with pytest.raises(srsinv.BadInput, match="nearest is strip_two_element"):
            ask("strip_two_elements")
        with pytest.raises(srsinv.BadInput, match="strip_two_element"):
            ask("../strip_two_element.csv")
