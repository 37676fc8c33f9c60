"""Contact as hard as it gets: slight and full, vertical edges, no profile, one cell, large numbers.

The reference is a dense active set in long double, that holds no tolerance.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.contact import press
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.skin import HalfSpace
from srsinv.forward.surface import Ridge, Surface, Tape
from srsinv.forward.viscoelastic import Viscoelastic
from srsinv.grid import Periodic
from tests.reference import dense_contact as dense
from tests.reference import layered
from tests.stability.matrix import PRECISIONS, Group, HardCase, within_bounds

CELL_M = 1e-4
MODULUS_PA = 1e5  # E*, of the plane strain that contact knows
HEIGHT_M = 1e-5
EPS = np.array([np.finfo(precision).eps for precision in PRECISIONS])
# What the solver has to reach, of the gap over the skin's displacement.
TOLERANCE = np.maximum(1e-10, 40 * EPS)
ROUNDED = tuple(100 * EPS)  # where nothing is iterated to a tolerance and nothing amplifies


def condition(n):
    """The shortest wave's stiffness over the longest one's: what errors of the gap gain."""
    return n / np.pi


def directly(n):
    """The error of full contact, by its formula in one transform."""
    return tuple(16 * EPS * condition(n))


def iterated(n):
    return tuple(TOLERANCE * condition(n))


def column(numbers):
    n = numbers["height_m"].size
    return dense.kernel(n, CELL_M, dense.half_space(numbers["modulus_Pa"]))


def contact_model(v):
    """Pressure and gap (2, n) in the case's sizes."""
    skin = HalfSpace(0.5, 0.75 * v["modulus_Pa"])
    contact = _solve(skin, v)
    return jnp.stack([contact.pressure_Pa / v["size_Pa"], contact.gap_m / v["size_m"]])


def _solve(skin, v):
    line = Periodic(v["height_m"].size, CELL_M)
    return press(line, skin, v["height_m"], v["nominal_Pa"])


def contact_reference(v, column=column):
    height = np.asarray(v["height_m"], np.longdouble) - np.max(v["height_m"])
    deviation, touching = dense.solve_contact(column(v), height, v["nominal_Pa"])
    gap = dense.moved(column(v), deviation) - height
    gap = np.where(touching, 0, gap - np.mean(gap[touching]))
    pressure = v["nominal_Pa"] + deviation
    return np.array([pressure / v["size_Pa"], gap / v["size_m"]], float)


def change(v):
    """The pressure's derivative along changes of all that is given, itself linear in them."""
    names = "height_m", "nominal_Pa", "modulus_Pa"

    def pressure(*given):
        return contact_model({**v, **dict(zip(names, given, strict=True))})[0]

    given, changes = ([v[before + name] for name in names] for before in ("", "d_"))
    return jax.jvp(pressure, tuple(given), tuple(changes))[1]


def change_reference(v):
    deviation, touching = dense.solve_contact(column(v), v["height_m"], v["nominal_Pa"])
    softer = v["d_modulus_Pa"] / v["modulus_Pa"]
    wanted = v["d_height_m"] + softer * dense.moved(column(v), deviation)
    wanted = wanted - wanted[np.argmax(touching)]
    slope = dense.slope(column(v), touching, wanted, v["d_nominal_Pa"])
    return np.asarray(slope / v["size_Pa"], float)


CHANGES = frozenset(("height_m", "nominal_Pa", "modulus_Pa", "size_Pa", "size_m"))
SIZES = frozenset(("size_Pa", "size_m"))
SKIN = SIZES | {"modulus_Pa", "bone_Pa"}  # the derivative of a layered skin is a long program


def case(name, hard, height, nominal, bounds, modulus=MODULUS_PA):
    numbers = {"height_m": height, "nominal_Pa": nominal, "modulus_Pa": modulus}
    deviation, _ = dense.solve_contact(column(numbers), height, nominal)
    sizes = {"size_Pa": float(nominal + np.max(deviation)), "size_m": float(np.ptp(height)) or 1.0}
    return HardCase(name, hard, numbers | sizes, bounds)


def changed(made: HardCase) -> HardCase:
    """The case of the derivative along changes of about their own size, without a pattern."""
    random, numbers = np.random.default_rng(5), made.numbers
    moves = {
        "d_height_m": random.normal(size=numbers["height_m"].size) * numbers["size_m"],
        "d_nominal_Pa": numbers["nominal_Pa"] / 2,
        "d_modulus_Pa": numbers["modulus_Pa"] / 3,
    }
    return made._replace(numbers=numbers | moves)


def profiles(n):
    x = np.arange(n) - n / 2 + 0.5
    wave = HEIGHT_M * np.cos(2 * np.pi * x / n)
    ridge = np.where(abs(x) < n / 8, 10 * HEIGHT_M, 0.0)
    one = np.where(np.arange(n) == n // 2, HEIGHT_M, 0.0)
    uneven = wave + 1e-3 * HEIGHT_M * np.sin(6 * np.pi * x / n + 1)
    rough = HEIGHT_M * np.random.default_rng(3).normal(size=n)
    checker = HEIGHT_M * np.where(np.arange(n) % 2, -1.0, 1.0)
    return wave, ridge, one, uneven, rough, checker


def settled(n):
    """Cases in which the contact set is no matter of rounding."""
    wave, ridge, one, uneven, rough, checker = profiles(n)
    full = np.pi * MODULUS_PA * HEIGHT_M / (n * CELL_M)  # the pressure that closes the wave
    # Heights that differ by less than float32's rounding of their depth below a far higher crest.
    near = one + np.roll(one, 1) * (1 - 1e-6)
    return (
        case("half a wave", "partial contact", wave, full / 2, iterated(n)),
        case("a cell or two", "the load is 1e-3 of the full one", uneven, 1e-3 * full, ROUNDED),
        case("one cell", "the load is 1e-9 of the full one", uneven, 1e-9 * full, ROUNDED),
        case("two cells", "nearly as high", near, 1e-6 * full, ROUNDED),
        case("closed", "a thousandth above closing", wave, 1.001 * full, directly(n)),
        case("ridge", "vertical edges", ridge, full, iterated(n)),
        case("slight ridge", "even contact, no load", ridge, 1e-6 * full, ROUNDED),
        case("groove", "vertical edges below", -ridge, full, iterated(n)),
        case("flat", "no profile at all", 0 * wave, full, ROUNDED),
        case("flat, far off", "no profile, a metre up", 0 * wave + 1, full, ROUNDED),
        case("atoms", "1e-12 m high", 1e-7 * wave, 5e-8 * full, iterated(n)),
        case("atoms, pressed", "1e-12 m under a full load", 1e-7 * wave, full, directly(n)),
        case("mountain", "a metre high", 1e5 * wave, 5e4 * full, iterated(n)),
        case("impulse", "one cell stands out", one, full, iterated(n)),
        case("pit", "one cell is missing", -one, full, iterated(n)),
        case("checkerboard", "the shortest wave", checker, full, iterated(n)),
        case("rough", "no two cells alike", rough, 5 * full, iterated(n)),
        case("soft", "1 Pa", wave, full / 2 / MODULUS_PA, iterated(n), 1.0),
        case("soft, pressed", "1 Pa under 1e12 Pa", wave, 1e12, directly(n), 1.0),
        case("stiff", "1e15 Pa", wave, full / 2 / MODULUS_PA * 1e15, iterated(n), 1e15),
        case("no load", "1e-9 Pa on 1e5 Pa", wave, 1e-9, ROUNDED),
        case("no load, stiff", "1e-9 Pa on 1e15 Pa", wave, 1e-9, ROUNDED, 1e15),
        case("great load", "1e12 Pa on 1e13 Pa", 1e7 * wave, 1e12, ROUNDED, 1e13),
    )


def closing(n):
    """About the pressure at which the last cell of a wave closes."""
    wave = profiles(n)[0]
    numbers = {"height_m": wave, "nominal_Pa": 1e9, "modulus_Pa": MODULUS_PA}
    closes = -float(np.min(dense.solve_contact(column(numbers), wave, 1e9)[0]))
    return tuple(
        case(f"closing {off:+.0e}", "by so much of the load", wave, closes * (1 + off), iterated(n))
        for off in (-1e-3, -1e-6, -1e-9, 0.0, 1e-9)
    )


# A skin that lags: p and gap under it, in the same sizes.
def lagging(v):
    skin = Viscoelastic(
        HalfSpace(0.5, 0.75 * v["modulus_Pa"]), v["fractions"], v["times_s"], v["speed_m_per_s"]
    )
    contact = _solve(skin, v)
    return jnp.stack([contact.pressure_Pa / v["size_Pa"], contact.gap_m / v["size_m"]])


def lagging_column(v):
    def compliance(k):
        turns = np.asarray(v["speed_m_per_s"] * v["times_s"])[:, None] * k
        modulus = 1 + np.sum(v["fractions"][:, None] * 1j * turns / (1 + 1j * turns), axis=0)
        return dense.half_space(v["modulus_Pa"])(k) / modulus

    return dense.kernel(v["height_m"].size, CELL_M, compliance)


def lag(made: HardCase, fraction, time_s, bounds):
    numbers = {
        **made.numbers,
        "fractions": np.array([fraction]),
        "times_s": np.array([time_s]),
        "speed_m_per_s": 0.05,
    }
    hard = f"{made.hard}, {fraction:g} times stiffer after {time_s:g} s"
    return HardCase(f"{made.name}, lag {fraction:g}", hard, numbers, bounds)


def lags(n):
    known = {made.name: made for made in settled(n)}
    # A lag turns the longest wave's share of a pressure into others, and back.
    loose = tuple(4 * np.array(iterated(n)))
    return (
        lag(known["half a wave"], 1.0, 1e-2, loose),
        lag(known["half a wave"], 100.0, 1e-3, loose),
        lag(known["one cell"], 10.0, 1e-2, ROUNDED),
        lag(known["slight ridge"], 10.0, 1e-2, loose),
        lag(known["flat"], 10.0, 1e-2, ROUNDED),
        lag(known["impulse"], 1e-9, 1e-9, loose),
    )


# A soft skin on bone: its longest waves are far stiffer than a half space's.
def bonded(v):
    skin = Layered([Layer(1e-3, 0.75 * v["modulus_Pa"], 0.5), Layer(None, v["bone_Pa"], 0.3)])
    contact = _solve(skin, v)
    return jnp.stack([contact.pressure_Pa / v["size_Pa"], contact.gap_m / v["size_m"]])


def bonded_column(v):
    layers = [(0.75 * v["modulus_Pa"], 0.5, 1e-3), (v["bone_Pa"], 0.3, None)]

    def compliance(k):
        values = [layered.solve(layers, 5e-4, float(each))[1][1, 0].real for each in k]
        return np.array(values, np.longdouble)

    return dense.kernel(v["height_m"].size, CELL_M, compliance)


def on_bone(n):
    known = {made.name: made for made in settled(n)}
    # The reference's dense system keeps about this much.
    bounds = tuple(np.maximum(iterated(n), 1e-9))
    return tuple(
        made._replace(numbers={**made.numbers, "bone_Pa": 1e9}, bounds=bounds)
        for made in (known["half a wave"], known["slight ridge"], known["rough"])
    )


# The vertical edges of shapes, and the derivative in all their numbers.
def edges(v):
    ridge = Ridge(v["ridge_m"], v["width_m"], v["ridge_x_m"], v["edge_m"])
    tape = Tape(v["tape_m"], v["width_m"], v["tape_x_m"], v["edge_m"])
    height = Surface([ridge, tape]).height(Periodic(48, CELL_M))
    return contact_model({**v, "height_m": height})


def edges_reference(v):
    x, sharp = CELL_M * np.arange(48), v["edge_m"] < 1e-9

    def strip(height, position):
        ends = x - position + v["width_m"] / 2, x - position - v["width_m"] / 2
        rise = [np.sign(end) if sharp else np.tanh(end / v["edge_m"]) for end in ends]
        return height * (rise[0] - rise[1]) / 2

    height = strip(v["ridge_m"], v["ridge_x_m"]) + strip(v["tape_m"], v["tape_x_m"])
    return contact_reference({**v, "height_m": height})


def edge(name, hard, edge_m, ridge_m=1e-4, tape_m=5e-5, nominal=2e3):
    places = {"width_m": 1.234e-3, "ridge_x_m": 1.05e-3, "tape_x_m": 3.37e-3, "edge_m": edge_m}
    sizes = {"size_Pa": 2 * nominal, "size_m": abs(ridge_m) + abs(tape_m)}
    given = {"ridge_m": ridge_m, "tape_m": tape_m, "nominal_Pa": nominal, "modulus_Pa": MODULUS_PA}
    return HardCase(name, hard, places | given | sizes, tuple(2 * np.array(iterated(48))))


# Values here, derivatives in test_more_derivatives.py.
ODD = Group("47 cells", contact_model, contact_reference, settled(47)[:4] + closing(47), SIZES)
SHORT = Group("3 cells", contact_model, contact_reference, settled(3)[8:12], SIZES)
LAG = Group("lag", lagging, partial(contact_reference, column=lagging_column), lags(48), SIZES)
BONE = Group("bone", bonded, partial(contact_reference, column=bonded_column), on_bone(48), SKIN)
GROUPS = (
    Group(
        "edges",
        edges,
        edges_reference,
        (
            edge("vertical", "a ridge and a tape, side by side", 0.0),
            edge("nearly vertical", "a millionth of a cell", 1e-10),
            edge("steep", "a tenth of a cell", 1e-5),
            edge("grooves", "both cut in", 0.0, -1e-4, -5e-5),
            edge("a film of tape", "1e-9 m high, touched beside a high ridge", 0.0, tape_m=1e-9),
        ),
        SIZES,
    ),
    Group("48 cells", contact_model, contact_reference, settled(48) + closing(48), SIZES),
    Group("change", change, change_reference, tuple(map(changed, settled(48))), CHANGES),
)


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("of", [ODD, SHORT, LAG, BONE], ids=lambda of: of.name)
def test_value(of, precision, margin):
    margin(*within_bounds(of, precision))
