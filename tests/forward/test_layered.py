"""Layered skins against a shared table, a dense system, closed forms and quadrature."""

import json
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv.forward.film import Film
from srsinv.forward.layered import Layer, Layered
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace, half_space_stress
from srsinv.grid import Open, Periodic
from tests.forward.setups import largest_error
from tests.reference import layered as dense
from tests.reference.exact_layers_line import LayersOnLine
from tests.refusals import refused
from tests.shared import SHARED, needs_shared
from tests.tiers import quick

DEPTH = 0.75e-3
FOAM = [(7e5, 0.5, 1.5e-3), (5e4, 0.3, 5e-3)]
PLATE = [(2e6, 0.5, 0.5e-3), (4e4, 0.5, 1e-2)]
ENDLESS = [(7e5, 0.5, 1e-3), (2e5, 0.45, None)]
SOFT = [(5e4, 0.3, 0.5e-3), (2.5e6, 0.0, 2e-3), (3e5, 0.4, None)]
STACKS = {"foam": FOAM, "plate": PLATE, "endless": ENDLESS, "soft": SOFT}


def skin(layers) -> Layered:
    """Always of four layers, the first one cut as often as needed: few programs to compile."""
    layers = list(layers)
    if layers[0][2] is None:
        layers.insert(0, (*layers[0][:2], 1e-3))
    while len(layers) < 4:
        modulus, nu, thickness = layers[0]
        layers[:1] = [(modulus, nu, thickness / 3), (modulus, nu, thickness * 2 / 3)]
    return Layered([Layer(h, modulus, nu) for modulus, nu, h in layers])


@eqx.filter_jit
def _skin_response(skin, k, depth):
    return skin.transfer(k, depth), skin.surface_displacement(k)


def skin_response(layers, k, depth=DEPTH):
    """Transfer (4, 2, k) and displacement (2, 2, k) at any k, always computed on sixty-four."""
    k = np.asarray(k, float)
    padded = np.concatenate([k, np.full(-len(k) % 64, 1.0)]).reshape(-1, 64)
    parts = [_skin_response(skin(layers), jnp.asarray(part), jnp.asarray(depth)) for part in padded]
    return tuple(np.concatenate(one, axis=-1)[..., : len(k)] for one in zip(*parts, strict=True))


@eqx.filter_jit
def _under_strip(skin, x, depth, width):
    return skin.strip_response(x, depth, width), skin.strip_slope(x, depth, width)


def under_strip(layers, x, width, depth=DEPTH):
    """Stress (4, 2, x) under a strip of traction and its slope, always computed on sixteen."""
    padded = np.resize(np.asarray(x, float), 16)
    responses = _under_strip(skin(layers), *(jnp.asarray(one) for one in (padded, depth, width)))
    return tuple(np.asarray(one)[..., : len(x)] for one in responses)


@needs_shared
def test_transfer_against_the_reference_table():
    """From k h = 1e-6 to 150 and ratios of moduli of 1e-8 to 1e8."""
    table = json.loads((SHARED / "reference" / "layered_transfer.json").read_text())
    for stack in table["stacks"]:
        layers = [
            (one["youngs_modulus_Pa"], one["poisson_ratio"], one["thickness_m"])
            for one in stack["layers"]
        ]
        k = np.array([row["k"] for row in stack["rows"]])
        longest = max([stack["depth_m"], *(h for _, _, h in layers if h is not None)])
        for ours, names in zip(
            skin_response(layers, k, stack["depth_m"]),
            (("sx", "sz", "txz"), ("surf_u", "surf_w")),
            strict=True,
        ):
            theirs = np.array(
                [
                    [[complex(*row[f"{name}_{load}"]) for row in stack["rows"]] for load in "pq"]
                    for name in names
                ]
            )
            error, largest = np.abs(ours[: len(names)] - theirs), np.abs(theirs).max(0)
            assert (error <= 1e-9 * largest[None] + 1e-290).all(), stack["name"]
            exact = (k * longest <= 1)[None, None] & (np.abs(theirs) > 1e-100)
            assert (error <= 1e-9 * np.abs(theirs))[exact].all(), stack["name"]


@pytest.mark.parametrize("name", STACKS)
def test_transfer_and_displacement_against_a_dense_system(name):
    """With the film in every layer, and on an interface, where it belongs to the layer above."""
    layers = STACKS[name]
    k = np.array([60.0, 200.0, 700.0, 2000.0, 6000.0])
    for depth in (0.3e-3, layers[0][2], layers[0][2] + 0.4e-3):
        stress, displacement = skin_response(layers, k, depth)
        for at, one in enumerate(k):
            expected = dense.solve(layers, depth, one)
            for ours, theirs in zip((stress[:3], displacement), expected, strict=True):
                scale = np.abs(theirs).max(0)
                assert (np.abs(ours[..., at] - theirs) < 1e-9 * scale[None]).all()
    nu = layers[0][1]
    stress = skin_response(layers, k, 0.3e-3)[0]
    np.testing.assert_allclose(stress[3], nu * (stress[0] + stress[1]), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_compliance_of_one_layer_on_a_rigid_core(nu):
    """The closed form, and for thin layers what is left of it: squeezing, and flow along the layer
    as k^2 h^3/(3 G)."""
    modulus, h = 3e5, 2e-3
    kappa = np.geomspace(0.3, 300, 10)
    free = 3 - 4 * nu
    # All times exp(-2 kappa).
    sinh, cosh = -np.expm1(-4 * kappa) / 2, (1 + np.exp(-4 * kappa)) / 2
    decay = np.exp(-2 * kappa)
    top = free * sinh - 2 * kappa * decay
    bottom = free * cosh + (2 * kappa**2 + 5 - 12 * nu + 8 * nu**2) * decay
    expected = 2 * (1 - nu**2) / modulus * h / kappa * top / bottom
    ours = skin_response([(modulus, nu, h)], kappa / h)[1][1, 0]
    np.testing.assert_allclose(ours.real, expected, rtol=1e-11)
    thin = 1e-6
    shear_modulus = modulus / (2 * (1 + nu))
    limit = (1 - 2 * nu) / (2 * (1 - nu)) * h / shear_modulus + thin**2 * h / (3 * shear_modulus)
    ours = skin_response([(modulus, nu, h)], [thin / h])[1]
    np.testing.assert_allclose(ours[1, 0, 0], limit, rtol=1e-10)
    np.testing.assert_allclose(ours[0, 1, 0], h / shear_modulus, rtol=1e-10)


def test_one_material_is_the_half_space():
    k = np.array([-2e3, -1.0, 0.0, 1e-3, 1.0, 50.0, 900.0, 6e3, 4e4, 3e5])
    for nu in (0.0, 0.3, 0.5):
        half = HalfSpace(nu, 3e5)
        layers = [(3e5, nu, 1e-4), (3e5, nu, 2e-2), (3e5, nu, None)]
        for depth in (0.6e-4, DEPTH, 0.03):
            ours = skin_response(layers, k, depth)[0]
            theirs = half_space_stress(np, k, depth, nu)
            scale = np.abs(theirs).max((0, 1))
            assert (np.abs(ours - theirs) <= 1e-10 * scale[None, None]).all()
        yields = skin_response(layers, k[3:])[1][1, 0].real
        np.testing.assert_allclose(yields, half.compliance(jnp.asarray(k[3:])), rtol=1e-12)


def test_a_thick_layer_hides_what_is_below():
    k = np.array([2e3, 1e4])
    thick = skin_response([(7e5, 0.4, 2e-2), (7e-3, 0.5, 1e-3)], k)
    half = skin_response([(7e5, 0.4, None)], k)
    for ours, theirs in zip(thick, half, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-14 * np.abs(theirs).max())


def test_cutting_a_layer_changes_nothing():
    k = np.geomspace(1e-2, 1e4, 12)
    whole = [(7e5, 0.5, 1e-3), (5e4, 0.3, 5e-3), (1e5, 0.45, 1e-3)]
    cut = [(7e5, 0.5, 1e-3), (5e4, 0.3, 1e-6), (5e4, 0.3, 5e-3 - 1e-6), (1e5, 0.45, 1e-3)]
    for ours, theirs in zip(
        skin_response(cut, k, 3e-3), skin_response(whole, k, 3e-3), strict=True
    ):
        scale = np.abs(theirs).max(0)
        assert (np.abs(ours - theirs) <= 1e-11 * scale[None]).all()


def test_a_film_on_an_interface_but_for_rounding_is_in_the_layer_above():
    """sigma_x jumps at an interface."""
    k, interface = [100.0, 1000.0], FOAM[0][2]
    on, rounded, below = (
        skin_response(FOAM, k, interface * (1 + part))[0][:, 0] for part in (0.0, 4e-16, 1e-9)
    )
    np.testing.assert_allclose(rounded, on, rtol=1e-10)
    assert (np.abs(below[0] - on[0]) > 0.5 * np.abs(on[0])).all()


def test_a_traced_film_below_the_face_of_the_core_is_at_that_face():
    k, face = [100.0, 1000.0], FOAM[0][2] + FOAM[1][2]
    for inside, at_face in zip(
        skin_response(FOAM, k, 1.5 * face), skin_response(FOAM, k, face), strict=True
    ):
        np.testing.assert_allclose(inside, at_face, rtol=1e-10)


@pytest.mark.parametrize("name", STACKS)
def test_reciprocity(name):
    """The work of p on the displacement by q is that of q on the displacement by p."""
    displacement = skin_response(STACKS[name], np.geomspace(1e-3, 2e3, 16))[1]
    scale = np.sqrt(np.abs(displacement[1, 0] * displacement[0, 1]))
    assert (np.abs(displacement[0, 0] - displacement[1, 1].conj()) <= 1e-11 * scale).all()


@pytest.mark.parametrize("name", STACKS)
def test_limits_at_zero_and_the_symmetry_about_it(name):
    stress = skin_response(STACKS[name], [-3.0, 0.0, 1e-7, 3.0])[0]
    np.testing.assert_array_equal(stress[..., 0].conj(), stress[..., 3])
    even = np.array([[1, 0], [1, 0], [0, 1], [1, 0]], bool)
    np.testing.assert_allclose(stress[..., 1][even], stress[..., 2][even].real, rtol=1e-6)
    assert (stress[..., 1][~even] == 0).all()
    np.testing.assert_allclose([stress[1, 0, 1], stress[2, 1, 1]], -1, rtol=1e-12)


@pytest.mark.full
def test_hard_stacks_stay_finite():
    """Layers of all sizes, ratios of 1e8 both ways, k h to 1e4: the traction that arrives at the
    film is never more than a stiff skin can gather, and the surface yields to what presses it."""
    rng = np.random.default_rng(3)
    for trial in range(12):
        layers = [
            (7e5 * 10.0 ** rng.integers(-8, 9), rng.choice([0.0, 0.3, 0.499999, 0.5]), h)
            for h in 10 ** rng.uniform(-5, -2, 4)
        ]
        if trial % 2:
            layers[-1] = (*layers[-1][:2], None)
        total = sum(h for _, _, h in layers if h is not None)
        k = np.geomspace(1e-6, 1e4, 16) / max(h for _, _, h in layers if h is not None)
        stress, displacement = skin_response(layers, k, rng.uniform(0.05, 0.95) * total)
        assert np.isfinite(stress).all()
        assert np.isfinite(displacement).all()
        assert (displacement[1, 0].real > 0).all()
        assert (displacement[0, 1].real > 0).all()
        # Elastic energy is positive for every mixture of p and q.
        cross = np.abs(displacement[0, 0]) ** 2
        assert (cross < displacement[1, 0].real * displacement[0, 1].real).all()


WIDTHS = (1e-4, 2e-3)
PLACES = np.array([0.0, 0.4e-3, -1.1e-3, 3.7e-3, 3.8e-3, -2e-2])


@cache
def by_quadrature(name):
    """The inverse Fourier integral of a strip's stress and of its slope, (width, 4, 2, x) each, by
    Gauss's rule on panels shorter than half a wave."""
    longest = 3 / (abs(PLACES).max() + max(WIDTHS))
    edges = [0.0, 1e-9]
    while edges[-1] < 45 / DEPTH:
        edges.append(edges[-1] + min(0.7 * edges[-1], longest))
    node, weight = np.polynomial.legendre.leggauss(16)
    half = np.diff(edges)[:, None] / 2
    k, weight = (np.array(edges[:-1])[:, None] + half * (1 + node)).ravel(), (half * weight).ravel()
    width = np.array(WIDTHS)[:, None, None]
    load = 2 * np.sin(k * width / 2) / k * np.exp(1j * k * PLACES[:, None]) * weight / np.pi
    transfer = skin_response(STACKS[name], k)[0]
    return [np.einsum("wxk,ijk->wijx", wave, transfer).real for wave in (load, 1j * k * load)]


@pytest.mark.full
@pytest.mark.parametrize("name", ["foam", "soft"])  # on a core, and on a half space
def test_strip_against_quadrature(name):
    for ours, theirs in zip(
        zip(*(under_strip(STACKS[name], PLACES, width) for width in WIDTHS), strict=True),
        by_quadrature(name),
        strict=True,
    ):
        for one, other in zip(ours, theirs, strict=True):
            assert largest_error(one, other) < 1e-9


STIFF_SKIN, SOFT_SKIN = ([(one, 0.5, 1e-3), (4.9e6 / one, 0.5, None)] for one in (7e5, 7.0))
FAR_APART = {
    "in a stiff skin": (STIFF_SKIN, 0.75e-3),
    "below a stiff skin": (STIFF_SKIN, 1.5e-3),
    "below a soft skin": (SOFT_SKIN, 1.5e-3),
}


@pytest.mark.full
@pytest.mark.parametrize(("layers", "depth"), [
    pytest.param(*given, id=name, marks=() if name == "below a stiff skin" else pytest.mark.claim)
    for name, given in FAR_APART.items()
])  # fmt: skip
def test_strip_on_moduli_far_apart(layers, depth):
    """The whole line out to 1e5 depths, against exact layers along complex wavenumbers."""
    x = np.array([0.0, 0.4e-3, 3.8e-3, -1e-2, 0.1, -1.0, 75.0])
    exact = LayersOnLine(layers, depth, step=0.07, digits=40)
    for ours, slope in zip(under_strip(layers, x, 1e-4, depth), (False, True), strict=True):
        assert largest_error(ours[:3], exact.strip(x, 1e-4, slope)) < 1e-8


@pytest.mark.full
@pytest.mark.parametrize("width", [0.01 * DEPTH, DEPTH, 1e3])
def test_strip_on_one_material_is_the_half_space(width):
    end = width / 2
    x = np.array([0.0, end, end - 1e-4, -end - 2e-3, end + 0.05, -end - 3])
    half = _under_strip(HalfSpace(0.3), *(jnp.asarray(one) for one in (x, DEPTH, width)))
    ours = under_strip([(3e5, 0.3, 2e-3), (3e5, 0.3, None)], x, width)
    for one, other in zip(ours, half, strict=True):
        assert largest_error(one, np.asarray(other)) < 1e-10


@pytest.mark.full
def test_enormous_strip_is_uniform_traction():
    """In its middle on a rigid core; outside it nothing. On a half space the shear's far tail is
    that of the base: as if there were no layers."""
    uniform = skin_response(PLATE, [0.0])[0][..., 0].real
    inside = under_strip(PLATE, [0.0, 30.0], 1e3)[0]
    np.testing.assert_allclose(inside, np.stack([uniform] * 2, -1), atol=1e-9)
    np.testing.assert_allclose(under_strip(PLATE, [700.0], 1e3)[0], 0.0, atol=1e-9)
    far = np.array([600.0, 900.0])
    jump = skin_response(ENDLESS, [1e-9])[0][0, 1, 0].imag
    expected = -jump / np.pi * np.log((far + 500) / (far - 500))
    np.testing.assert_allclose(under_strip(ENDLESS, far, 1e3)[0][0, 1], expected, rtol=1e-6)


WEIGHTS = np.random.default_rng(1).normal(size=(4, 2, 1))


def in_waves(args):
    """One number made of the transfer and the displacement at every k."""
    skin, k, depth = args
    transfer, moved = skin.transfer(k, depth), skin.surface_displacement(k)
    stress = jnp.sum(WEIGHTS * (transfer.real + transfer.imag))
    return stress + 1e6 * jnp.sum(WEIGHTS[:2] * (moved.real + moved.imag))


def in_strip(args):
    skin, x, depth = args
    return jnp.sum(WEIGHTS * skin.strip_response(x, depth, jnp.asarray(1e-3)))


def uncut(layers) -> Layered:
    """Of two layers, which is one short program for all derivatives."""
    whole = Layered([Layer(h, modulus, nu) for modulus, nu, h in layers])
    return jax.tree.map(np.asarray, whole)


WAVES_IN_REVERSE = eqx.filter_jit(eqx.filter_value_and_grad(in_waves))


def waves(args, way):
    """The value, and its derivative along `way` by reverse differentiation."""
    value, gradient = WAVES_IN_REVERSE(args)
    pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(way), strict=True)
    return value, sum(np.sum(np.asarray(g) * w) for g, w in pairs)


@eqx.filter_jit
def strip(args, way):
    """The same by forward differentiation."""
    return eqx.filter_jvp(in_strip, (args,), (way,))


@pytest.mark.full
@pytest.mark.parametrize("depth", [0.3e-3, 2.2e-3], ids=["upper", "lower"])
@pytest.mark.parametrize(
    ("derived", "at"), [(waves, [-400.0, 30.0, 800.0, 5e3]), (strip, [1e-4, -2e-3])]
)
def test_gradient_against_differences(derived, at, depth):
    """In every number at once, along a random direction of relative changes; none at a bound, which
    a difference would step over."""
    args = jax.tree.map(
        np.asarray, (uncut([(7e5, 0.48, 1.5e-3), (5e4, 0.3, 5e-3)]), np.array(at), depth)
    )
    rng = np.random.default_rng(2)
    way = jax.tree.map(lambda leaf: leaf * rng.uniform(-1, 1, leaf.shape), args)

    def moved(step):
        return float(derived(jax.tree.map(lambda leaf, to: leaf + step * to, args, way), way)[0])

    step = 1e-3
    near, far = moved(step) - moved(-step), moved(2 * step) - moved(-2 * step)
    slope = (8 * near - far) / (12 * step)
    np.testing.assert_allclose(float(derived(args, way)[1]), slope, rtol=1e-7)


@pytest.mark.full
@pytest.mark.parametrize("layers", [FOAM, PLATE], ids=["foam", "plate"])
def test_gradients_are_finite_at_the_hard_places(layers):
    """At k h of 0 to 1e4, with the film on an interface and on the core."""
    for depth in (layers[0][2], sum(h for _, _, h in layers)):
        k = np.array([-1e-4, 0.0, 2e6, 1e7])
        value, gradient = WAVES_IN_REVERSE((uncut(layers), k, np.array(depth)))
        assert np.isfinite(value)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


@pytest.mark.full
def test_single_precision():
    """To a few of its round-offs, from k = 0 to where nothing arrives."""
    k, x = [0.0, 1e-3, 10.0, 300.0, 2e3, 1e5, 1e7], [0.0, 1e-3, -5e-3, 0.2]

    def run():
        return skin_response(FOAM, k)[0], under_strip(FOAM, x, 1e-3)[0]

    double = run()
    with jax.enable_x64(False):
        single = run()
    for wide, narrow in zip(double, single, strict=True):
        assert narrow.dtype.itemsize * 2 == wide.dtype.itemsize
        assert np.abs(narrow - wide).max() < 2e-5 * np.abs(wide).max()


@pytest.mark.parametrize("kind", quick([Periodic, Open], Periodic))
def test_adjoint_on_a_line(kind):
    line, sensor = kind(32, 2e-4), Sensor([Film()], skin(FOAM))

    @eqx.filter_jit
    def both(line, sensor, r, y):
        operator = line.operator(sensor.charge())
        return operator(r), operator.adjoint(y)

    rng = np.random.default_rng(4)
    r, y = rng.normal(size=(2, 32)), rng.normal(size=(1, 32))
    forward, adjoint = both(line, sensor, jnp.asarray(r), jnp.asarray(y))
    scale = np.linalg.norm(forward) * np.linalg.norm(y)
    assert scale > 0
    assert abs(np.vdot(y, forward) - np.vdot(adjoint, r)) < 1e-12 * scale


def test_refusals():
    layer = Layer(1e-3)
    refused(lambda: Layered([]), "skin.layers", "[]", "give a list")
    refused(lambda: Layered([Layer(), layer]), "Layer 1 of 2", "thickness_m", "half space")
    refused(lambda: Layer(0.0), "thickness_m", "0.0", "positive")
    refused(lambda: Layer(1e-3, -7e5), "youngs_modulus_Pa", "-700000.0", "positive")
    refused(lambda: Layer(1e-3, 7e5, 0.6), "poisson_ratio", "0.6", "between 0 and 0.5")
    deep = Layered([layer, Layer(2e-3)])
    for asked in (
        lambda: deep.check_depth(3.1e-3),
        lambda: deep.transfer(jnp.ones(1), jnp.asarray(3.1e-3)),
        lambda: deep.strip_response(jnp.ones(1), jnp.asarray(3.1e-3), jnp.asarray(1e-3)),
    ):
        refused(asked, "0.0031", "0.003 m", "rigid core")
    deep.check_depth(3e-3)
    Layered([layer, Layer()]).check_depth(1.0)


def test_words():
    words = Layered([Layer(1.5e-3), Layer(5e-3, 5e4, 0.3)]).words
    assert words.startswith("1.5 mm of 700 kPa (Poisson's ratio 0.5) on 5 mm of 50.0 kPa")
    assert words.endswith("on a rigid core")
    assert Layered([Layer()]).words.startswith("a half space of 700 kPa")
