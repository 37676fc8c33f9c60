"""Datasets as a run leaves them, made from the half space's transfer by numpy alone."""

import numpy as np
import xarray as xr

_D1, _D2, _D3, _NU = 23e-12, 3e-12, -33e-12, 0.5
_NAMES = ("0: 1 to x, 3 to z", "1: 1 to z, 3 to x", "2: 30 deg")
_ANGLES = np.array([0.0, np.pi / 2, np.pi / 6])
_OFFSETS = np.array([0.0, 0.0, 0.9e-3])
_DEPTHS = np.array([0.75e-3, 0.75e-3, 1.1e-3])
_STRESSES = ("sigma_x", "sigma_z", "tau_xz", "sigma_y")
_WEIGHTS = {"Wiener": 0.0, "Tikhonov": 3e-12}  # of k^4 beside 1/S


def dataset(
    *,
    elements: int = 2,
    methods: tuple[str, ...] = ("Wiener", "Tikhonov"),
    truth: bool = True,
    samples: int = 512,
    length_m: float = 0.04,
    gap: bool = True,
    signal_unit: str = "V",
    pressure_unit: str = "Pa",
    mean_unobserved: str = "",
    speed_m_per_s: float = 0.05,
    p_alone: bool = False,
) -> xr.Dataset:
    """Every stage of a run; without `truth` what a recording leaves, with `p_alone` what q = mu p
    does."""
    rng = np.random.default_rng(1)
    x = (np.arange(samples) + 0.5) / samples * length_m - length_m / 2
    k = 2 * np.pi * np.fft.rfftfreq(samples, length_m / samples)
    friction = 0.3 + 0.3 * (np.tanh((x + 6e-3) / 3e-4) - np.tanh((x - 1e-2) / 3e-4)) / 2
    p = 1e4 + 2.5e3 * (np.tanh((x + 1.5e-3) / 2e-4) - np.tanh((x - 1.5e-3) / 2e-4))
    traction = np.stack([p, friction * p])

    stress_from, gain = _transfer(k, elements, speed_m_per_s)
    spectrum = np.fft.rfft(traction)
    stress = np.fft.irfft(np.einsum("esck,ck->esk", stress_from, spectrum), samples)
    clean = np.fft.irfft(np.einsum("eck,ck->ek", gain, spectrum), samples)
    sigma = 1e-2 * clean.std()
    signal = clean + sigma * rng.normal(size=clean.shape)
    observed = np.ones(signal.shape, bool)
    if gap:
        observed[:, x > 0.36 * length_m] = False

    prior = np.array([4e3, 4e3]) ** 2
    inverse, stderr, resolution, kernel = zip(
        *(_linear(gain, sigma**2, prior, _WEIGHTS.get(m, 0.0), k) for m in methods), strict=True
    )
    estimate = np.stack(
        [np.fft.irfft(np.einsum("cek,ek->ck", h, np.fft.rfft(signal)), samples) for h in inverse]
    )
    estimate += traction.mean(axis=-1)[:, None]
    fitted = np.fft.irfft(np.einsum("eck,mck->mek", gain, np.fft.rfft(estimate)), samples)
    lag = (np.arange(samples) - samples // 2) * length_m / samples
    inflation = np.where(observed.any(axis=0), 1.0, 6.0)

    units = {
        "traction": pressure_unit, "friction": "1", "stress": pressure_unit, "charge": "C",
        "current": "A", "signal": signal_unit, "signal_noise_free": signal_unit,
        "fitted_signal": signal_unit, "whitened_residual": "1", "observed": "1",
        "estimate": pressure_unit, "estimate_stderr": pressure_unit, "resolution": "1",
        "sensor_gain": f"{signal_unit}/{pressure_unit}", "signal_power": f"{signal_unit}^2",
        "noise_power": f"{signal_unit}^2", "cutoff": "rad/m", "averaging_kernel": "1/m",
        "element_angle": "rad",
    }  # fmt: skip
    along = ("element", "x")
    recovered = ("estimator", "component", "x")
    variables = {
        "signal": (along, np.where(observed, signal, np.nan)),
        "observed": (along, observed.astype(np.int8)),
        "estimate": (recovered, estimate),
        "estimate_stderr": (recovered, np.stack(stderr)[..., None] * inflation),
        "fitted_signal": (("estimator", *along), fitted),
        "whitened_residual": (
            ("estimator", *along), np.where(observed, (signal - fitted) / sigma, np.nan),
        ),
        "sensor_gain": (("element", "component", "wavenumber"), np.abs(gain)),
        "signal_power": (("element", "wavenumber"), np.abs(np.fft.rfft(signal)) ** 2 / samples),
        "noise_power": ("wavenumber", np.full(k.size, sigma**2)),
        "resolution": (("estimator", "component", "wavenumber"), np.stack(resolution)),
        "cutoff": (("estimator", "component"), [[_cutoff(k, r) for r in rs] for rs in resolution]),
        "averaging_kernel": (
            ("estimator", "component_out", "component_in", "lag"),
            np.fft.fftshift(np.fft.irfft(np.stack(kernel), samples), -1) * samples / length_m,
        ),
        "kernel_width": (("estimator", "component"), np.full((len(methods), 2), 1e-3)),
        "element_depth": ("element", _DEPTHS[:elements]),
        "element_width": ("element", np.full(elements, 0.7e-3)),
        "element_length": ("element", np.full(elements, 8e-3)),
        "element_offset": ("element", _OFFSETS[:elements]),
        "element_angle": ("element", _ANGLES[:elements]),
    }  # fmt: skip
    if truth:
        variables |= {
            "traction": (("component", "x"), traction),
            "friction": ("x", friction),
            "stress": (("element", "stress_name", "x"), stress),
            "charge": (along, np.cumsum(clean, -1) * length_m / samples / speed_m_per_s / 1e6),
            "current": (along, clean / 1e6),
            "signal_noise_free": (along, clean),
        }
    result = xr.Dataset(
        variables,
        coords={
            "x": x, "wavenumber": k, "lag": lag, "component": ["p", "q"],
            "component_out": ["p", "q"], "component_in": ["p", "q"],
            "element": list(_NAMES[:elements]), "stress_name": list(_STRESSES),
            "estimator": list(methods),
        },
        attrs={
            "title": "synthetic", "speed_m_per_s": speed_m_per_s, "signal_unit": signal_unit,
            "line": "periodic", "mean_unobserved": mean_unobserved,
        },
    )  # fmt: skip
    if p_alone:
        for name in ("sensor_gain", "resolution", "cutoff"):
            result[name].values[:, 1] = np.nan
        result["averaging_kernel"].values[:, 1:] = np.nan
        result["averaging_kernel"].values[:, :, 1:] = np.nan
    for name, variable in result.data_vars.items():
        variable.attrs["units"] = units.get(str(name), "m")
    return result


def recording(**changes) -> xr.Dataset:
    """What the smallest recording leaves: one element, one method, no truth, a gain not known."""
    smallest = {
        "elements": 1, "methods": ("Wiener",), "truth": False, "samples": 128,
        "signal_unit": "counts", "pressure_unit": "1", "p_alone": True,
    }  # fmt: skip
    return dataset(**(smallest | changes))


def without_samples() -> xr.Dataset:
    """A run none of whose samples is there."""
    empty = dataset(samples=64)
    for name in ("signal", "whitened_residual", "estimate_stderr", "cutoff"):
        empty[name].values[...] = np.nan
    empty["observed"].values[...] = 0
    return empty


def _transfer(k, elements, speed_m_per_s):
    """Stress (element, stress, component, k) and signal (element, component, k) per traction."""
    stress, gain = [], []
    for depth, angle, offset in zip(_DEPTHS, _ANGLES, _OFFSETS, strict=True):
        kz, fall = k * depth, np.exp(-k * depth)
        sigma_x = np.stack([-(1 - kz) * fall, 1j * (2 - kz) * fall])
        sigma_z = np.stack([-(1 + kz) * fall, 1j * kz * fall])
        tau = np.stack([1j * kz * fall, -(1 - kz) * fall])
        sigma_y = _NU * (sigma_x + sigma_z)
        c, s = np.cos(angle), np.sin(angle)
        along = sigma_x * c**2 + sigma_z * s**2 + 2 * tau * s * c
        through = sigma_x * s**2 + sigma_z * c**2 - 2 * tau * s * c
        charge = 0.7e-3 * 8e-3 * (_D1 * along + _D2 * sigma_y + _D3 * through)
        stress.append(np.stack([sigma_x, sigma_z, tau, sigma_y]))
        gain.append(1e6 * speed_m_per_s * 1j * k * charge * np.exp(1j * k * offset))
    return np.stack(stress)[:elements], np.stack(gain)[:elements]


def _linear(gain, noise, prior, weight, k):
    """A linear inverse (c, e, k), its standard error (c,), resolution (c, k), kernel (c, c, k)."""
    g = np.moveaxis(gain, -1, 0)
    adjoint = g.conj().swapaxes(-1, -2)
    precision = adjoint @ g / noise
    penalty = np.diag(1 / prior) * (
        1 + (k[:, None, None] / 600) ** 2 + weight * k[:, None, None] ** 4
    )
    covariance = np.linalg.inv(precision + penalty)
    resolution_matrix = covariance @ precision
    inverse = covariance @ adjoint / noise
    stderr = np.sqrt(np.einsum("kcc->c", covariance).real / k.size)
    resolution = np.einsum("kcc->ck", resolution_matrix).real
    return np.moveaxis(inverse, 0, -1), stderr, resolution, np.moveaxis(resolution_matrix, 0, -1)


def _cutoff(k, resolution):
    """Where the resolution falls through one half for the last time."""
    falls = np.flatnonzero((resolution[:-1] > 0.5) & (resolution[1:] <= 0.5))
    if not falls.size:
        return np.nan
    i = falls[-1]
    return np.interp(-0.5, -resolution[i : i + 2], k[i : i + 2])
