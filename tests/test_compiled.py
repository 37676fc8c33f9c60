"""Stored programs: loaded without tracing, told from others, made again when damaged."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from srsinv import compiled as module
from srsinv.compiled import compiled, stored
from srsinv.forward.feature import LineFeature
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.grid import Convolution
from srsinv.inverse.features.estimate import FeatureEstimate
from srsinv.inverse.features.method import FeatureFit
from srsinv.inverse.features.model import FeatureModel
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.nonlinear import fit
from srsinv.inverse.problem import Problem
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.inverse.wiener import Wiener

N, LENGTH = 48, 96
K = np.linspace(0.0, 900.0, 7)
FEATURES = {"line": LineFeature()}
TRACED = "/jax/core/compile/jaxpr_trace_duration"


def kernel(n: int = N, length: int = LENGTH, size: float = 1.0) -> Convolution:
    values = size * np.exp(-np.minimum(np.arange(length), length - np.arange(length)) / 3)
    return Convolution(jnp.fft.rfft(values)[None, None], jnp.asarray(1e-3), n, length, True)


@contextmanager
def traces() -> Iterator[list[str]]:
    """What jax traces inside."""
    traced: list[str] = []

    def listen(name: str, _: float, **about) -> None:
        if name == TRACED:
            traced.append(about.get("fun_name", ""))

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield traced
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def symbol(folder: Path, of: Convolution, k=K) -> np.ndarray:
    """By a store of its own, as in another process."""
    with stored(folder):
        return np.asarray(of.symbol(jnp.asarray(k)))


def programs(folder: Path) -> list[Path]:
    return sorted(folder.glob("*-program"))


def test_a_second_run_traces_nothing_and_gives_the_same(tmp_path):
    of = kernel()
    first = symbol(tmp_path, of)
    k = jnp.asarray(K)
    with stored(tmp_path), traces() as traced:
        second = np.asarray(of.symbol(k))
    assert not traced
    np.testing.assert_array_equal(first, second)
    np.testing.assert_allclose(first, np.asarray(of.symbol(k)), rtol=1e-12)


def test_values_are_inputs_and_forms_are_programs(tmp_path):
    once = symbol(tmp_path, kernel())
    (one,) = programs(tmp_path)
    np.testing.assert_allclose(symbol(tmp_path, kernel(size=2.0)), 2 * once, rtol=1e-12)
    assert programs(tmp_path) == [one]
    for count, (of, k) in enumerate(
        [(kernel(n=40), K), (kernel(length=100), K), (kernel(), K[:5])]
    ):
        symbol(tmp_path, of, k)
        assert len(programs(tmp_path)) == count + 2


@compiled
def kind_of(value, x):
    return (x, type(value).__name__)


def test_numbers_that_are_equal_are_told_apart(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_NAMED", (*module._NAMED, "tests"))
    with stored(tmp_path):
        said = [kind_of(value, jnp.asarray(0.0))[1] for value in (1, True, 1.0)]
    assert said == ["int", "bool", "float"]
    assert len(programs(tmp_path)) == 3


def test_a_refusal_of_a_traced_function_is_raised_once(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_NAMED", (*module._NAMED, "tests"))
    REFUSED.clear()
    with stored(tmp_path), pytest.raises(ValueError, match="never"):
        refused(jnp.asarray(0.0))
    assert len(REFUSED) == 1


REFUSED: list[str] = []


@compiled
def refused(x):
    REFUSED.append("traced")
    raise ValueError("never")


def test_another_version_makes_its_own(tmp_path, monkeypatch):
    symbol(tmp_path, kernel())
    monkeypatch.setattr(module, "_version", lambda: "another")
    symbol(tmp_path, kernel())
    assert len(programs(tmp_path)) == 2


@pytest.mark.parametrize(
    "spoil", [lambda data: data[:40], lambda _: b"", lambda data: data[:-1] + b"x"]
)
def test_a_damaged_program_is_made_again(tmp_path, spoil):
    expected = symbol(tmp_path, kernel())
    (path,) = programs(tmp_path)
    path.write_bytes(spoil(path.read_bytes()))
    for _ in range(2):
        np.testing.assert_array_equal(symbol(tmp_path, kernel()), expected)
    assert len(path.read_bytes()) > 1000


def test_derivatives_and_batches_pass_through_it(tmp_path):
    def energy(k):
        return jnp.sum(jnp.abs(kernel().symbol(k)) ** 2)

    expected = jax.grad(energy)(K)
    with stored(tmp_path):
        np.testing.assert_allclose(jax.grad(energy)(K), expected, rtol=1e-12, atol=1e-13)
        batch = jax.vmap(kernel().symbol)(jnp.stack([K, -K]))
    np.testing.assert_allclose(batch[1], batch[0].conj(), atol=1e-12)
    assert programs(tmp_path) == []


class Own(eqx.Module):
    """A class that is no part of the package."""

    factor: jax.Array

    @compiled
    def __call__(self, x):
        return self.factor * x


def test_what_is_not_the_packages_is_left_to_jax(tmp_path):
    with stored(tmp_path):
        assert Own(jnp.asarray(2.0))(jnp.asarray(3.0)) == 6.0
        assert compiled(lambda x: x + 1)(jnp.asarray(1.0)) == 2.0
    assert programs(tmp_path) == []


def test_what_a_program_returns_keeps_its_form(tmp_path):
    """A module with fields that are no arrays."""
    expected = kernel().circulant()
    for _ in range(2):
        with stored(tmp_path):
            made = kernel().circulant()
        assert jax.tree.structure(made) == jax.tree.structure(expected)
        np.testing.assert_allclose(made.transfer, expected.transfer, atol=1e-13)


@pytest.mark.full
def test_a_process_runs_what_another_has_compiled(tmp_path):
    """LAPACK, too, which jax makes ready when it traces what needs it."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_COMPILATION")}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    command = [sys.executable, "-c", COUNTED, "experiment=fit_recording", "figures=none"]
    counts = [
        int(subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout.split()[-1])
        for _ in range(2)
    ]  # fmt: skip
    assert counts[0] > 10
    assert counts[1] == 0


COUNTED = """
import sys
import jax
from srsinv.__main__ import main
missed = []
jax.monitoring.register_event_listener(
    lambda name, **_: missed.append(name) if name.endswith("cache_misses") else None
)
assert main(sys.argv[1:]) == 0
print(len(missed))
"""


def test_another_recording_of_another_length_compiles_nothing():
    """Two methods on lines of two lengths, which share the program of a cell's responses."""
    rng = np.random.default_rng(0)

    def invert(samples: int) -> None:
        motion = Motion.from_speed(np.arange(samples) / 5e3, np.full(samples, 0.05), 0.0)
        signal = 1e-6 * rng.normal(size=(2, samples))
        signal[:, 300:330] = np.nan
        problem = Problem(Sensor(), motion, signal, SampleNoise(1e-6, is_estimate=True))
        for method in (Tikhonov(), Wiener(scale="evidence")):
            assert method(problem).stats["path"] == "iterative"

    invert(1500)
    with traces() as traced:
        invert(1570)
    assert not traced


def test_a_fit_of_another_length_compiles_nothing():
    """Of a line load, from the search to its traction: both lengths share 1536 samples and 1792
    cells."""
    rng, problems = np.random.default_rng(0), []
    truth = {"line": {"position_m": 7e-3, "load_N_per_m": 5.0, "shear_N_per_m": 2.0}}
    for samples in (1320, 1420):
        motion = Motion.from_speed(np.arange(samples) / 5e3, np.full(samples, 0.05), 0.0)
        model = FeatureModel.along(Sensor(), motion).with_features(FEATURES)
        signal = np.asarray(model(truth))
        noise_rms = 1e-3 * np.abs(signal).max()
        noisy = signal + noise_rms * rng.normal(size=signal.shape)
        problems.append(Problem(Sensor(), motion, noisy, SampleNoise(noise_rms)))

    def fitted(problem: Problem) -> FeatureEstimate:
        estimate = FeatureFit(FEATURES)(problem)
        assert estimate.quality == "good"
        assert estimate.fitted.shape == estimate.fit.residual.shape == problem.data.shape
        assert estimate.profiles()["p"][0].shape == (estimate.line.n,)
        return estimate

    fitted(problems[0])
    with traces() as traced:
        value, stderr = fitted(problems[1]).parameters["position_m"]
    assert not traced
    assert abs(value - truth["line"]["position_m"]) < 4 * stderr


class Decay(eqx.Module):
    """A decay by two facts of the amplifier, which some fits hold."""

    time_s: np.ndarray
    may_hold: tuple[str, ...] = eqx.field(static=True, default=("facts",))

    def __call__(self, params):
        gain, drift = params["facts"]
        decay = jnp.exp(-self.time_s / params["tau_s"])
        return (1 + 0.1 * gain) * params["size"] * decay + 0.01 * drift * self.time_s


@pytest.mark.parametrize("linear", [(), ("size",)])
def test_a_fit_that_holds_facts_is_by_the_program_of_a_fit_beside_them(linear):
    """And it gives what a program of its own gives, with errors of fewer parameters."""
    time_s = np.linspace(0, 3, 60)
    facts = np.array([0.5, -1.0])
    truth = {"size": 2.0, "tau_s": 0.7, "facts": facts}
    y = np.asarray(Decay(time_s)(truth)) + 0.02 * np.random.default_rng(2).normal(size=60)
    start = {"size": 1.5, "tau_s": 1.0, "facts": facts}
    priors = {"size": (1.8, 0.5), "tau_s": (0.8, 0.5)}
    held = {"noise": 0.02, "free": [*priors], "linear": linear, "priors": priors}
    beside = {"noise": 0.02, "linear": linear, "priors": priors | {"facts": (facts, 1.0)}}
    wide = fit(Decay(time_s), start, y, **beside)
    with traces() as traced:
        narrow = fit(Decay(time_s), start, y, **held)
    own = fit(Decay(time_s, ()), start, y, **held)
    assert "_searched" not in " ".join(traced)
    assert narrow.names == own.names == ("size", "tau_s")
    np.testing.assert_array_equal(narrow.value["facts"], facts)
    for name in narrow.names:
        np.testing.assert_allclose(narrow.value[name], own.value[name], rtol=1e-9)
        np.testing.assert_allclose(narrow.stderr[name], own.stderr[name], rtol=1e-6)
        assert wide.stderr[name] >= narrow.stderr[name]
    assert wide.stderr["size"] > 2 * narrow.stderr["size"]
    assert narrow.stats["degrees_of_freedom"] == own.stats["degrees_of_freedom"] == 58
    np.testing.assert_allclose(narrow.log_evidence, own.log_evidence, rtol=1e-9)
