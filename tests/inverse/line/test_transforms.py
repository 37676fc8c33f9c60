"""Transforms of long rows, which go one by one, are those of numpy."""

import numpy as np
import pytest

from srsinv.inverse.line import transforms


@pytest.mark.parametrize("shape", [(3000,), (2, 3001), (2, 3, 3000)])
@pytest.mark.parametrize("length", [None, 4096, 6001])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_row_by_row(monkeypatch, shape, length, dtype):
    monkeypatch.setattr(transforms, "LONG", 100)
    values = np.random.default_rng(0).normal(size=shape).astype(dtype)
    n, tolerance = length or shape[-1], 50 * np.finfo(dtype).eps * np.sqrt(shape[-1])
    spectrum = transforms.to_spectrum(values, length)
    assert spectrum.dtype == np.result_type(dtype, np.complex64)
    np.testing.assert_allclose(spectrum, np.fft.rfft(values, n), atol=tolerance)
    back = transforms.from_spectrum(spectrum, n)
    assert back.dtype == dtype
    padded = np.pad(values, [(0, 0)] * (len(shape) - 1) + [(0, n - shape[-1])])
    np.testing.assert_allclose(back, padded, atol=tolerance)
