"""A film far stiffer than the rubber that it is bonded into: a membrane that carries force along x.

A membrane of tension T = E_f t/(1 - nu_f^2), under the force N per length along y, strains by N/T.
Its force acts on the rubber as dN/dx and strains it back. At the depth z in an incompressible half
space of shear modulus G, that strain is -k^2 C N with

    C(k) = [1 + (1 - 2 kz + 2 (kz)^2) exp(-2kz)] / (4 G k).

Without the film the strain there is (sigma_x - sigma_z)/(4 G). Of an endless sheet,
N = T/(1 + T k^2 C) times this strain. A strip |x| < a has N = 0 at its ends:

    N/T + [k^2 C] N = (sigma_x - sigma_z)/(4 G)  on |x| < a,

the equation of a lifting line (Prandtl), solved in sqrt(1 - (x/a)^2) U_n(x/a). A strip that does
not yield, deep in the rubber, has N = (sigma_x - sigma_z) sqrt(a^2 - x^2) in a uniform stress.
"""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy
import xarray
from jaxtyping import Complex, Float

from experiments.fig05_orientation import similarity
from srsinv.errors import mapping, number
from srsinv.forward.film import Film
from srsinv.forward.sensor import Sensor
from srsinv.grid import Line
from srsinv.report.data import dataset, scalars

TERMS = np.arange(0, 16, 2)  # n of U_n, even ones: odd ones have no mean
NODES = 400  # of Gauss's rule for the free surface's part
WANTED = {  # of the settings of a film, with their bounds
    "youngs_modulus_Pa": ("a positive modulus in Pa", {"above": 0}),
    "poisson_ratio": ("a ratio from 0 to 0.5", {"least": 0, "most": 0.5}),
    "thickness_m": ("a positive thickness in metres", {"above": 0}),
}
FARTHEST = 20.0  # kz at which exp(-2kz) ends it


class StiffFilm:
    """A film and the rubber around it.

    - `modulus_Pa`, `poisson_ratio`, `thickness_m`: of the film, all laminated strips together.
    - `width_m`: along x. `depth_m`: in rubber of Young's modulus `rubber_Pa`, incompressible.
    """

    def __init__(
        self,
        modulus_Pa: float,
        poisson_ratio: float,
        thickness_m: float,
        width_m: float,
        depth_m: float,
        rubber_Pa: float,
    ):
        self.poisson_ratio, self.thickness_m = poisson_ratio, thickness_m
        self.tension_N_per_m = modulus_Pa * thickness_m / (1 - poisson_ratio**2)
        self.half_m, self.depth_m, self.shear_Pa = width_m / 2, depth_m, rubber_Pa / 3

    @property
    def strain_ratio(self) -> float:
        """Mean strain of the strip over that of the rubber without it, in a uniform stress."""
        stress = self.strip(np.zeros(1))[0] * self.thickness_m
        return float(stress * 4 * self.shear_Pa / self.tension_N_per_m)

    def compliance(self, k: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """C(k) [m^2/N] for k > 0: displacement along x per force along x, both at the depth."""
        kz = k * self.depth_m
        return (1 + (1 - 2 * kz + 2 * kz**2) * np.exp(-2 * kz)) / (4 * self.shear_Pa * k)

    def sheet(self, k: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Stress along x of an endless sheet over sigma_x - sigma_z of the rubber without it, for
        k > 0."""
        tension = self.tension_N_per_m
        force = tension / (1 + tension * k**2 * self.compliance(k))
        return force / (4 * self.shear_Pa * self.thickness_m)

    def strip(self, k: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Stress along x of the strip, mean over its width, over sigma_x - sigma_z of the rubber
        without it, a wave exp(ikx) about the strip's middle, for k >= 0."""
        amplitude = np.linalg.solve(self._resistance, self._waves(k * self.half_m) * self.half_m)
        return np.pi / 4 * amplitude[0] / (4 * self.shear_Pa * self.thickness_m)

    @cached_property
    def _resistance(self) -> Float[np.ndarray, "n n"]:
        """The strain of each term of N, weighted with each term."""
        own = np.diag(np.pi * (TERMS + 1) / (8 * self.shear_Pa))
        ratio = self.half_m / self.depth_m
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        kz, weights = FARTHEST / 2 * (nodes + 1), FARTHEST / 2 * weights
        waves = self._waves(kz * ratio)
        image = (1 - 2 * kz + 2 * kz**2) * np.exp(-2 * kz) * kz * weights * ratio**2
        free_surface = (waves * image) @ waves.T / (4 * np.pi * self.shear_Pa)
        angle = np.pi / 2 * (nodes + 1)
        terms = np.sin((TERMS[:, None] + 1) * angle)
        yields = terms * np.sin(angle) * np.pi / 2 * np.polynomial.legendre.leggauss(NODES)[1]
        return own + free_surface + self.half_m / self.tension_N_per_m * yields @ terms.T

    @staticmethod
    def _waves(ka: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n k"]:
        """Integral of each term times cos(kx), over a."""
        order, sign = TERMS[:, None] + 1, (-1.0) ** (TERMS[:, None] // 2)
        small = ka < 1e-8
        ratio = scipy.special.jv(order, np.where(small, 1.0, ka)) / np.where(small, 1.0, ka)
        return np.pi * order * sign * np.where(small, np.where(order == 1, 0.5, 0.0), ratio)


def charge(
    film: Film,
    stress: Complex[np.ndarray, "4 c k"],
    membrane: Any,
    average: Any,
    poisson_ratio: float,
) -> Complex[np.ndarray, "c k"]:
    """Charge [C] of a flat stiff film per unit traction, from the `stress` of the rubber without
    it: `membrane` times sigma_x - sigma_z along x and `average` times sigma_z across, in plane
    strain."""
    along, across = membrane * (stress[0] - stress[1]), average * stress[1]
    area = float(film.strips * film.width_m * film.length_m)
    d1, d2, d3 = (float(each) for each in (film.piezo.d1, film.piezo.d2, film.piezo.d3))
    return area * (d1 * along + d2 * poisson_ratio * (along + across) + d3 * across)


def film_responses(line: Line, sensor: Sensor, given: Mapping[str, Any]) -> xarray.Dataset:
    """Charge under a line load of 1 N/m for a film like rubber, a stiff strip and a stiff sheet,
    and their charge at the pitch of a grating. Raises `BadInput` for settings out of range."""
    key, film = "skin_design.film", sensor.elements[0]
    node = mapping(key, given["film"], "a mapping of " + ", ".join(WANTED))
    values = [
        number(f"{key}.{name}", node.get(name), words, **bounds)
        for name, (words, bounds) in WANTED.items()
    ]
    wanted = "a positive length in metres"
    grating = number("skin_design.grating_m", given["grating_m"], wanted, above=0)
    modulus, nu, thick = values
    rubber = sensor.skin.surface_modulus_Pa
    assert rubber is not None  # a half space's
    width, depth = float(film.width_m), float(film.depth_m)
    stiff = StiffFilm(modulus, nu, film.strips * thick, width, depth, rubber)
    k = np.append(np.asarray(line.k)[1:], 2 * np.pi / grating)
    along = jnp.asarray(k)
    theory = film if film.effects else film.with_strip_average()
    stress = sensor.skin.transfer(along, film.depth_m)
    mean = np.sinc(k * width / (2 * np.pi))
    waves = {
        "like rubber": np.asarray(theory.charge_transfer(stress, along)),
        "stiff strip": charge(film, np.asarray(stress), stiff.strip(k), mean, nu),
        "stiff sheet": charge(film, np.asarray(stress), stiff.sheet(k) * mean, mean, nu),
    }
    p = np.stack([each[0] for each in waves.values()])
    spectrum = np.concatenate([np.zeros((len(p), 1)), p[:, :-1]], axis=1) / float(line.cell_m)
    over_x = np.fft.fftshift(np.fft.irfft(spectrum, line.n), axes=-1)
    rate = np.gradient(over_x, float(line.cell_m), axis=-1)
    alike = similarity(np.stack([np.stack([rate[0], each]) for each in rate]))
    size, at = np.abs(rate).max(axis=-1), np.abs(p[:, -1])
    distance = float(line.cell_m) * (np.arange(line.n) - line.n // 2)
    of = "film"
    return dataset(
        {
            "line_charge": ((of, "distance"), over_x, "C"),
            "line_gain": (of, size / size[0], "1", "signal_over_theory_{film}"),
            "grating_gain": (of, at / at[0], "1", "grating_over_theory_{film}"),
            "film_similarity": (of, alike, "1", "similarity_to_theory_{film}"),
            "transfer": ((of, "wavenumber"), np.abs(p[:, :-1]), "C/Pa"),
            **scalars({
                "strip_stress_ratio": float(stiff.strip(np.zeros(1))[0]),
                "strip_strain_ratio": stiff.strain_ratio,
            }),
        },
        {"film": (list(waves), "1"), "distance": (distance, "m"), "wavenumber": (k[:-1], "rad/m")},
        grating_m=grating, film_Pa=modulus, film_poisson_ratio=nu, film_m=film.strips * thick,
        strip_width_m=width,
    )  # fmt: skip
