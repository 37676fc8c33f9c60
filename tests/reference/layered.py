"""Bonded layers by one dense system, derived apart from srsinv and not importing it.

In every layer Airy's function is f(z) exp(ikx) with four free constants, so that sigma_x = f'',
sigma_z = -k^2 f, tau_xz = -ik f', and Hooke's law in plane strain gives the displacements. Lengths
are in units of 1/k, k > 0; good for layers that are neither very thin nor very thick in them.
"""

import numpy as np

Material = tuple[float, float, float | None]  # modulus [Pa], Poisson's ratio, thickness [m] or None


def solve(layers: list[Material], depth: float, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Stress (3, 2) at the film, rows sigma_x, sigma_z, tau_xz, and displacement (2, 2) of the
    surface [m/Pa], rows u, w; columns from unit p and from unit q."""
    # Moduli in units of the first one keep the system's rows of like size.
    unit = layers[0][0]
    scaled = [(e / unit, nu, None if h is None else k * h) for e, nu, h in layers]
    columns = [4 if h is not None else 2 for _, _, h in layers]
    start = np.concatenate([[0], np.cumsum(columns)])
    rows, at = np.zeros((start[-1], start[-1]), complex), 2
    rows[:2, : start[1]] = _state(scaled[0], 0.0)[[1, 2]]
    for j in range(len(layers) - 1):
        above, below = _state(scaled[j], scaled[j][2]), _state(scaled[j + 1], 0.0)
        rows[at : at + 4, start[j] : start[j + 1]] = above[1:]
        rows[at : at + 4, start[j + 1] : start[j + 2]] = -below[1:]
        at += 4
    if scaled[-1][2] is not None:
        rows[at:, start[-2] :] = _state(scaled[-1], scaled[-1][2])[3:]
    load = np.zeros((start[-1], 2))
    load[:2] = [[-1, 0], [0, -1]]
    constants = np.linalg.solve(rows, load)
    top, j = 0.0, 0
    while scaled[j][2] is not None and k * depth > top + scaled[j][2]:
        top, j = top + scaled[j][2], j + 1
    film = _state(scaled[j], k * depth - top) @ constants[start[j] : start[j + 1]]
    surface = _state(scaled[0], 0.0) @ constants[: start[1]]
    return film[:3], surface[3:] / (k * unit)


def _state(layer, zeta: float) -> np.ndarray:
    """sigma_x, sigma_z, tau_xz, u and w (5, constant) at zeta under the layer's top."""
    modulus, nu, h = layer
    decay = np.exp(-zeta)
    order = np.arange(4)
    f = [(-1.0) ** order * decay, (-1.0) ** order * (zeta - order) * decay]
    if h is not None:
        eta, growth = h - zeta, np.exp(zeta - h)
        f += [growth + 0 * order, (eta - order) * growth]
    f0, f1, f2, f3 = np.array(f).T
    bend = (1 + nu) / modulus
    u = -1j * bend * ((1 - nu) * f2 + nu * f0)
    w = bend * ((1 - nu) * f3 - (2 - nu) * f1)
    return np.array([f2, -f0, -1j * f1, u, w])
