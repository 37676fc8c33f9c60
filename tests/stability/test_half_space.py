"""The half space's stress from the surface down to where nothing arrives, under waves and strips,
and the film's charge at awkward angles."""

import jax.numpy as jnp
import numpy as np

from srsinv.forward.antiplane import AntiplaneHalfSpace
from srsinv.forward.film import Film, Piezo
from srsinv.forward.skin import HalfSpace
from tests.reference import exact
from tests.stability.matrix import PRECISIONS, Group, HardCase

CELL_M, DEPTH_M = 1e-4, 0.75e-3
# |k| from nothing to the shortest wave that cells of CELL_M hold.
K = np.array([0.0, 1e-9, -1.0, 1e3, -1e4, np.pi / CELL_M])
SIDES = np.array([1.0, -1.0, 1.0001, -0.9999, 1.0, -1.0])
EPS = np.array([np.finfo(precision).eps for precision in PRECISIONS])


def round_offs(count):
    """That many round-offs in float64 and in float32."""
    return tuple(float(bound) for bound in count * EPS)


def parts(value):
    return jnp.stack([value.real, value.imag])


def transfer(v):
    """All stresses from p and q, and both antiplane ones, at the wavenumbers `k`."""
    in_plane = HalfSpace(v["nu"]).transfer(v["k"], v["depth_m"])
    return parts(in_plane), parts(AntiplaneHalfSpace().transfer(v["k"], v["depth_m"]))


def transfer_reference(v):
    in_plane = [with_across(exact.stress(k, v["depth_m"]).tolist(), v["nu"]) for k in v["k"]]
    across = [exact.antiplane(k, v["depth_m"]) for k in v["k"]]
    return tuple(
        np.stack([one.real, one.imag])
        for one in (np.moveaxis(exact.as_float(each), 0, -1) for each in (in_plane, across))
    )


def with_across(rows, nu):
    """sigma_x, sigma_z, tau_xz and in plane strain sigma_y."""
    nu = exact.mp.mpf(float(nu))
    return [*rows, [nu * (rows[0][load] + rows[1][load]) for load in range(2)]]


def wave(name, hard, k, depth_m, nu=0.5, count=8.0):
    """exp(-kz) alone has the condition kz."""
    return HardCase(name, hard, {"k": k, "depth_m": depth_m, "nu": nu}, round_offs(count))


def deep(kz, nu):
    """Nothing but waves about as short as kz says: each counts against the others alone."""
    name, hard = f"kz {kz:g}, nu {nu:g}", "exp(-kz) is next to nothing, or nothing"
    return wave(name, hard, SIDES * kz / DEPTH_M, DEPTH_M, nu, 4 * kz)


def strip(slope):
    def model(v):
        at = v["x"], v["depth_m"], v["width_m"]
        half, across = HalfSpace(v["nu"]), AntiplaneHalfSpace()
        in_plane = half.strip_slope(*at) if slope else half.strip_response(*at)
        # p's stress and q's fall off by different powers.
        other = across.strip_slope(*at) if slope else across.strip_response(*at)
        return in_plane[:, 0], in_plane[:, 1], other[0], other[1]

    return model


def strip_reference(slope):
    def reference(v):
        at = [(x, v["depth_m"], v["width_m"], slope) for x in v["x"]]
        rows = exact.as_float([with_across(exact.strip(*one), v["nu"]) for one in at])
        across = exact.as_float([exact.antiplane_strip(*one) for one in at])
        return rows[..., 0].T, rows[..., 1].T, across[:, 0], across[:, 1]

    return reference


def under(name, hard, x, width, depth_m=DEPTH_M, nu=0.5, count=32.0):
    """x and width in depths."""
    x = np.resize(np.asarray(x, float), 6) * depth_m
    numbers = {"x": x, "depth_m": depth_m, "width_m": width * depth_m, "nu": nu}
    return HardCase(name, hard, numbers, round_offs(count))


def strips():
    """A strip far narrower than the depth, as wide, and far wider: below it, at its ends and about
    them, and away from it. (Under a narrow one q gives next to nothing: its largest is a depth
    beside it, so that the places include that.)"""
    for width in (1e-6, 1e-3, 1.0, 10.0, 1e3, 1e6):
        half, near = width / 2, min(width, 1.0)
        middle = [0, 0.1 * width, -half - 0.7]
        yield under(f"middle, {width:g}", "symmetry: nothing is left of some", middle, width)
        ends = [half, -half, half + 0.01 * near, -half + 0.01 * near, half - near / 3, half + 0.7]
        yield under(f"ends, {width:g}", "one end is straight above", ends, width, nu=0.0)
        for away in (1.3, 30.0, 1e3, 1e6):
            x = SIDES * (half + away)
            hard = "two ends that look alike, far away"
            yield under(f"{away:g} away, {width:g}", hard, x, width)
    for depth_m in (1e-9, 1e3):
        yield under(f"depth {depth_m:g} m", "lengths of no skin", [0.5, 1, -3], 1.0, depth_m)


def charge(v):
    piezo = Piezo(v["d1"], v["d2"], v["d3"])
    return Film(
        angle_rad=v["angle_rad"], width_m=1.0, length_m=1.0, piezo=piezo
    ).charge_per_stress()


def charge_reference(v):
    """Of unit stresses, each turned into the film's axes as a tensor."""
    angle, (d1, d2, d3) = v["angle_rad"], (v[f"d{i}"] for i in (1, 2, 3))
    c, s = (
        exact.as_float([f(exact.mp.mpf(float(angle)))])[0] for f in (exact.mp.cos, exact.mp.sin)
    )
    turn = np.array([[c, s], [-s, c]])
    units = np.array([[[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 1], [1, 0]]])
    film_stresses = [turn @ unit @ turn.T for unit in units]
    return np.array([*(d1 * one[0, 0] + d3 * one[1, 1] for one in film_stresses), d2])


def turned(angle_rad, hard, count=16.0):
    numbers = {"angle_rad": angle_rad, "d1": 23e-12, "d2": 3e-12, "d3": -33e-12}
    return HardCase(f"{angle_rad:.9g} rad", hard, numbers, round_offs(count))


GROUPS = (
    Group(
        "half space, transfer",
        transfer,
        transfer_reference,
        (
            wave("depth 0.01 cells", "the film lies on the surface", K, 0.01 * CELL_M),
            wave("depth 0.1 cells", "the film lies near the surface", K, 0.1 * CELL_M, 0.0),
            wave("depth 1 cell", "half the waves are gone", K, CELL_M),
            wave("depth 10 cells", "the shortest waves are gone", K, 10 * CELL_M),
            wave("depth 100 cells", "the shortest waves underflow", K, 100 * CELL_M),
            wave("depth 1000 cells", "every wave but the longest underflows", K, 1e3 * CELL_M),
            wave("k = 0", "what is odd in k jumps there", 0 * K, DEPTH_M),
            wave("tiny k", "k z is next to nothing", SIDES * 1e-12, DEPTH_M),
            *(deep(kz, nu) for kz in (80, 100, 700, 745, 1e4) for nu in (0.0, 0.5)),
        ),
    ),
    Group(
        "half space, strip",
        strip(False),
        strip_reference(False),
        tuple(strips()),
    ),
    Group(
        "half space, strip's slope",
        strip(True),
        strip_reference(True),
        tuple(strips()),
    ),
    Group(
        "film",
        charge,
        charge_reference,
        (
            turned(0.0, "no shear is felt"),
            turned(1e-12, "next to none is"),
            turned(-1e-5, "c^2 rounds to one"),
            turned(np.pi / 2, "no shear is felt, and pi/2 is rounded"),
            turned(np.pi / 2 - 1e-6, "next to none is"),
            turned(np.arctan(np.sqrt(23 / 33)), "sigma_x is not felt"),
            turned(1e6, "many turns"),
            turned(-1e6, "many turns"),
        ),
    ),
)


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound
