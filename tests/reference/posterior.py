"""The Gaussian posterior of traction under a rate sensor in any number of digits (mpmath), derived
apart from srsinv and not importing it.

On a periodic line with every sample there each wavenumber is alone: a model of two numbers at most.
With samples missing, the whole is conditioned in the space of the data. The mean of the traction
(k = 0) is not in a rate signal, and left out.
"""

import mpmath as mp
import numpy as np

from tests.reference import exact

D1, D2, D3 = mp.mpf("23e-12"), mp.mpf("3e-12"), mp.mpf("-33e-12")


def gains(n, cell, depth, angles, widths, lengths, speed, resistance) -> list[list[list]]:
    """G[k][element][component] [V/Pa] at the half spectrum of n cells: R u ik d1 S11 + d2 Syy +
    d3 S33 in film axes, averaged over the strip, from cell averages. nu = 1/2."""
    cell, depth, speed = mp.mpf(float(cell)), mp.mpf(float(depth)), mp.mpf(float(speed))
    by_wavenumber = []
    for j in range(n // 2 + 1):
        k = 2 * mp.pi * j / (n * cell)
        stress = exact.stress(k, depth)
        rows = []
        for angle, width, length in zip(angles, widths, lengths, strict=True):
            c, s = mp.cos(mp.mpf(float(angle))), mp.sin(mp.mpf(float(angle)))
            width, length = mp.mpf(float(width)), mp.mpf(float(length))
            row = []
            for component in range(2):
                x, z, t = (stress[i, component] for i in range(3))
                along = x * c**2 + z * s**2 + 2 * t * s * c
                across = x * s**2 + z * c**2 - 2 * t * s * c
                charge = D1 * along + D2 * (x + z) / 2 + D3 * across
                gain = mp.mpf(float(resistance)) * speed * width * length * 1j * k * charge
                gain *= mp.sincpi(k * width / (2 * mp.pi)) / mp.sincpi(k * cell / (2 * mp.pi))
                # The last wavenumber of an even count stands for both signs.
                row.append(mp.mpc(gain.real) if 2 * j == n else gain)
            rows.append(row)
        by_wavenumber.append(rows)
    return by_wavenumber


def spectral(gain, noise, precision, data) -> tuple[np.ndarray, np.ndarray]:
    """Value and standard error (c, n) of the deviation from the mean.

    `gain[k][e][c]`; `noise` power per sample; `precision[k][c]`: P; `data` (e, n).
    """
    elements, n = np.shape(data)
    unknowns = len(gain[0][0])
    turn = [mp.expjpi(mp.mpf(-2 * j) / n) for j in range(n)]
    spectrum = [
        [
            mp.fsum(mp.mpf(float(data[e][x])) * turn[j * x % n] for x in range(n))
            for e in range(elements)
        ]
        for j in range(n // 2 + 1)
    ]
    noise = mp.mpf(float(noise))
    values = np.zeros((unknowns, n), object)
    variance = [mp.mpf(0)] * unknowns
    for j in range(1, n // 2 + 1):
        normal, right = mp.matrix(unknowns, unknowns), mp.matrix(unknowns, 1)
        for a in range(unknowns):
            for b in range(unknowns):
                products = (mp.conj(g[a]) * g[b] for g in gain[j])
                normal[a, b] = mp.fsum(products) / noise
            normal[a, a] += precision[j][a]
            terms = (mp.conj(g[a]) * d for g, d in zip(gain[j], spectrum[j], strict=True))
            right[a] = mp.fsum(terms) / noise
        inverse = normal**-1
        estimate = inverse * right
        weight = 1 if 2 * j == n else 2
        for c in range(unknowns):
            variance[c] += weight * inverse[c, c].real / n
            for x in range(n):
                values[c, x] += weight * (estimate[c] * mp.conj(turn[j * x % n])).real / n
    stderr = [[mp.sqrt(v)] * n for v in variance]
    return exact.as_float(values), exact.as_float(stderr)


def conditioned(gain, noise, power, data, observed) -> tuple[np.ndarray, np.ndarray]:
    """The same from the samples `observed` (e, n): S G^T (G S G^T + N)^-1 m, `power[k][c]` is S."""
    elements, n = np.shape(data)
    unknowns = len(gain[0][0])

    turn = [mp.expjpi(mp.mpf(2 * j) / n) for j in range(n)]
    halves = [1 if j == 0 or 2 * j == n else 2 for j in range(n // 2 + 1)]

    def kernel(spectrum):
        """(n,): the circular kernel of a half spectrum."""
        pairs = list(zip(halves, spectrum, strict=True))
        return [
            mp.fsum(w * (g * turn[j * x % n]).real for j, (w, g) in enumerate(pairs)) / n
            for x in range(n)
        ]

    ks = range(n // 2 + 1)
    power = [[mp.mpf(0)] * unknowns, *power[1:]]
    rows = [(e, x) for e in range(elements) for x in range(n) if observed[e][x]]
    # S G^T and G S G^T are circulant too, before rows are left out.
    cross = [
        [kernel([power[j][c] * mp.conj(gain[j][e][c]) for j in ks]) for e in range(elements)]
        for c in range(unknowns)
    ]
    both = [
        [
            kernel([
                mp.fsum(gain[j][e][c] * power[j][c] * mp.conj(gain[j][f][c])
                        for c in range(unknowns))
                for j in ks
            ])
            for f in range(elements)
        ]
        for e in range(elements)
    ]  # fmt: skip
    size = len(rows)
    covariance, noise = mp.matrix(size, size), mp.mpf(float(noise))
    for a, (e, x) in enumerate(rows):
        for b, (f, y) in enumerate(rows):
            covariance[a, b] = both[e][f][(x - y) % n] + (noise if a == b else 0)
    inverse = covariance**-1
    weighed = inverse * mp.matrix([mp.mpf(float(data[e][x])) for e, x in rows])
    value, stderr = np.zeros((unknowns, n), object), np.zeros((unknowns, n), object)
    for c in range(unknowns):
        own = kernel([power[j][c] for j in ks])[0]
        for x in range(n):
            line = mp.matrix([[cross[c][e][(x - y) % n] for e, y in rows]])
            value[c, x] = (line * weighed)[0]
            stderr[c, x] = mp.sqrt(own - (line * inverse * line.T)[0])
    return exact.as_float(value), exact.as_float(stderr)
