"""Closed forms of the half space and the film, derived apart from srsinv and not importing it.

All of it rests on one integral. With zeta = x + iz and the Cauchy transform of a pressure
W(zeta) = integral p(x') / (zeta - x') dx', the kernels c t^m of a line load are combinations of
1/zeta and 1/zeta^2, so that every stress is a combination of Re W, Im W, Re W' and Im W'. Each
`cauchy_*` returns W and its first two derivatives; the second gives the slope of stress along x.
Two second opinions, the strip by its angles (Johnson 1985, 2.5) and plain quadrature of the radial
stress of line loads, take no part in that derivation.

Stress arrays are (3, 2, x): rows sigma_x, sigma_z, tau_xz [Pa], columns from p and from q. Tension
is positive, z points into the body, p > 0 pushes into it and q > 0 acts along +x. SI units.
"""

import numpy as np

Cauchy = tuple[np.ndarray, np.ndarray, np.ndarray]


def stress(cauchy: Cauchy, z: float) -> np.ndarray:
    """Stress at depth z when p, and likewise q, has this Cauchy transform."""
    return _combine(cauchy[0], cauchy[1], z)


def stress_slope(cauchy: Cauchy, z: float) -> np.ndarray:
    """d/dx of `stress`."""
    return _combine(cauchy[1], cauchy[2], z)


def _combine(w: np.ndarray, dw: np.ndarray, z: float) -> np.ndarray:
    (re, im), (d_re, d_im) = ((np.real(f), np.imag(f)) for f in (w, dw))
    b0 = (im - z * d_re) / np.pi
    b1 = -z * d_im / np.pi
    b2 = (im + z * d_re) / np.pi
    b3 = -(2 * re - z * d_im) / np.pi
    return np.array([[b2, b3], [b0, b1], [b1, b2]])


def cauchy_line(x: np.ndarray, z: float) -> Cauchy:
    """Line load of 1 N/m at x = 0."""
    zeta = x + 1j * z
    return 1 / zeta, -1 / zeta**2, 2 / zeta**3


def cauchy_strip(x: np.ndarray, z: float, width: float) -> Cauchy:
    """1 Pa on |x| < width/2."""
    left, right = x + width / 2 + 1j * z, x - width / 2 + 1j * z
    return np.log(left) - np.log(right), 1 / left - 1 / right, 1 / right**2 - 1 / left**2


def cauchy_cosine(x: np.ndarray, z: float, k: float, phase: float = 0.0) -> Cauchy:
    """cos(k x + phase) Pa, k > 0: the contour closes in the upper half plane on one pole."""
    w = -1j * np.pi * np.exp(1j * (k * (x + 1j * z) + phase))
    return w, 1j * k * w, -(k**2) * w


def cauchy_hertz(x: np.ndarray, z: float, a: float) -> Cauchy:
    """sqrt(1 - x^2/a^2) Pa on |x| < a."""
    zeta = x + 1j * z
    root = np.sqrt(zeta - a) * np.sqrt(zeta + a)
    return np.pi / a * (zeta - root), np.pi / a * (1 - zeta / root), np.pi * a / root**3


def cauchy_hertz_periodic(x: np.ndarray, z: float, a: float, period: float) -> Cauchy:
    """`cauchy_hertz` repeated with `period`: the images' 1/zeta add up to a cotangent.

    Gauss's rule for the weight sqrt(1 - s^2) makes the integral exact to round-off for z > a/10.
    """
    angle = np.pi * np.arange(1, 400) / 400
    source, weight = a * np.cos(angle), a * np.pi / 400 * np.sin(angle) ** 2
    k = np.pi / period
    image = k * (x[:, None] + 1j * z - source)
    cot, csc2 = 1 / np.tan(image), 1 / np.sin(image) ** 2
    return k * cot @ weight, -(k**2) * csc2 @ weight, 2 * k**3 * (csc2 * cot) @ weight


def line_load(x: np.ndarray, z: float) -> np.ndarray:
    """The radial stress of line loads: -(2/pi r) (p cos + q sin) along r, nothing across it."""
    r = np.hypot(x, z)
    along = np.array([x / r, z / r])
    radial = -2 / (np.pi * r) * along[::-1]
    (sx, txz), (_, sz) = along[:, None] * along
    return np.array([sx * radial, sz * radial, txz * radial])


def strip_by_angles(x: np.ndarray, z: float, width: float) -> np.ndarray:
    """1 Pa on |x| < width/2 by the angles theta1, theta2 that its ends see (Johnson 2.5)."""
    a = width / 2
    theta1, theta2 = np.arctan2(z, x - a), np.arctan2(z, x + a)
    r1, r2 = np.hypot(x - a, z), np.hypot(x + a, z)
    swept, sines = 2 * (theta1 - theta2), np.sin(2 * theta1) - np.sin(2 * theta2)
    cosines = np.cos(2 * theta1) - np.cos(2 * theta2)
    logs = 4 * np.log(r1 / r2)
    return np.array(
        [
            [-(swept + sines), logs - cosines],
            [-(swept - sines), cosines],
            [cosines, -(swept + sines)],
        ]
    ) / (2 * np.pi)


def by_quadrature(pressure, low: float, high: float, x: np.ndarray, z: float) -> np.ndarray:
    """Stress under pressure(x') on low < x' < high, summed line load by line load.

    Composite Gauss's rule with panels shorter than z/2, in the angle that smooths both ends.
    """
    panels = int(2 * np.pi * (high - low) / z) + 8
    nodes, weights = np.polynomial.legendre.leggauss(16)
    middle = (np.arange(panels) + 0.5)[:, None] * np.pi / panels
    angle = (middle + np.pi / 2 / panels * nodes).ravel()
    source = (low + high) / 2 - (high - low) / 2 * np.cos(angle)
    weight = np.tile(weights, panels) * np.pi / 2 / panels * (high - low) / 2 * np.sin(angle)
    total = np.zeros((3, 2, x.size))
    for at, load in zip(source, weight * pressure(source), strict=True):
        total += load * line_load(x - at, z)
    return total


def in_film_axes(stress_xz: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """S11 and S33 of rows (sigma_x, sigma_z, tau_xz), axis 1 turned by `angle` from +x to +z."""
    sx, sz, txz = stress_xz
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = np.einsum("ai,ij...,bj->ab...", turn, np.array([[sx, txz], [txz, sz]]), turn)
    return turned[0, 0], turned[1, 1]


def charge_density(stress_xz: np.ndarray, angle: float, d: tuple, nu: float = 0.5) -> np.ndarray:
    """Charge per electrode area [C/m^2] of a film with constants d = (d1, d2, d3)."""
    s11, s33 = in_film_axes(stress_xz, angle)
    return d[0] * s11 + d[1] * nu * (stress_xz[0] + stress_xz[1]) + d[2] * s33
