"""Recordings whose columns are odd: each is one small scan with some of its columns changed."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import yaml

from tests.jobs.sidecars import SENSOR

NAMES = {"t": "time_s", "x": "position_m", "u": "speed_m_per_s", "a": "voltage_0_V",
         "b": "voltage_1_V"}  # fmt: skip
Columns = Mapping[str, np.ndarray]
N = 400
I = np.arange(N)  # noqa: E741
SIGN = (-1.0) ** I
RANDOM = np.random.default_rng(1).standard_normal(N)


def usual() -> dict[str, np.ndarray]:
    """A clean scan of 4 mm at 20 mm/s."""
    t = I / 2000.0
    place = (t - t.mean()) * 25
    hill = 1e-2 * np.exp(-(place**2) / 2)
    noise = 1e-4 * np.random.default_rng(0).standard_normal((2, N))
    a, b = -place * hill + noise[0], (1 - place**2) * hill + noise[1]
    return {"t": t, "x": 0.02 * t, "a": a, "b": b}


def _both(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Columns], Columns]:
    return lambda c: {"a": change(c["a"]), "b": change(c["b"])}


def _position(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Columns], Columns]:
    return lambda c: {"x": change(c["x"])}


def _times(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Columns], Columns]:
    return lambda c: {"t": change(c["t"])}


def _speed(values: np.ndarray) -> Callable[[Columns], Columns]:
    return lambda _: {"u": np.broadcast_to(values, N)}


def _rows(count: int) -> Callable[[Columns], Columns]:
    return lambda c: {name: column[:count] for name, column in c.items()}


# What is changed, by name: new columns; a speed stands in place of the positions.
ODD: dict[str, Callable[[Columns], Columns]] = {
    "as it is": lambda _: {},
    **{f"{count} rows": _rows(count) for count in (1, 2, 3, 4, 8, 20)},
    # signals
    "all constant": _both(lambda v: 0 * v + 0.5),
    "one constant": lambda _: {"b": np.full(N, 0.5)},
    "all zero": _both(np.zeros_like),
    "one zero": lambda _: {"b": np.zeros(N)},
    "all empty": _both(lambda v: v * np.nan),
    "one empty": lambda _: {"b": np.full(N, np.nan)},
    "one sample": lambda c: {"b": np.where(I == 5, c["b"], np.nan)},
    "half empty": lambda c: {"b": np.where(I < N // 2, c["b"], np.nan)},
    "by turns empty": lambda c: {"a": np.where(SIGN > 0, c["a"], np.nan),
                                 "b": np.where(SIGN < 0, c["b"], np.nan)},
    "infinite": lambda _: {"b": np.full(N, np.inf)},
    "1e300 V": lambda c: {"b": c["b"] * 1e300},
    "1e17 V": _both(lambda v: v * 1e17),
    "1e-20 V": _both(lambda v: v * 1e-20),
    "denormal": _both(lambda v: np.where(v > 0, 5e-324, 0.0)),
    "1e9 + 1e-6 V": _both(lambda v: 1e9 + 1e-6 * np.sign(v)),
    "1e15 V and a little": _both(lambda v: 1e15 + v),
    "alternating": _both(lambda v: SIGN * 1.0),
    "two levels": _both(np.sign),
    "an impulse": _both(lambda v: (I == N // 2) * 1.0),
    "a ramp": _both(lambda v: I * 1e-3),
    "the same twice": lambda c: {"b": c["a"]},
    "over range": lambda c: {"a": np.where(c["a"] > 5e-3, 9.9e37, c["a"])},
    # times
    "times equal": _times(lambda t: 0 * t),
    "times equal in tens": _times(lambda t: np.floor(t * 200) / 200),
    "times falling": _times(lambda t: -t),
    "times shuffled": _times(np.random.default_rng(0).permutation),
    "times * 1e300": _times(lambda t: t * 1e300),
    "times * 1e-300": _times(lambda t: t * 1e-300),
    "times * 1e12": _times(lambda t: t * 1e12),
    "times * 1e-12": _times(lambda t: t * 1e-12),
    "times + 1e12": _times(lambda t: t + 1e12),
    "times with a gap": _times(lambda t: t + 1e6 * (N // 2 < I)),
    "times of a logarithm": _times(lambda t: 10.0 ** np.linspace(-9, 2, N)),
    # motion
    "positions constant": _position(lambda x: 0 * x + 1e-3),
    "positions * 1e300": _position(lambda x: x * 1e300),
    "positions * 1e5": _position(lambda x: x * 1e5),
    "positions * 1e-5": _position(lambda x: x * 1e-5),
    "positions * 1e-9": _position(lambda x: x * 1e-9),
    "positions nearly equal": _position(lambda x: 1e-9 * I / N),
    "positions + 1e9": _position(lambda x: x + 1e9),
    "positions of a counter that wraps": _position(lambda x: x % 1.3e-3),
    "positions with a step back": _position(lambda x: x - 2e-3 * (N // 2 < I)),
    "positions with a spike": _position(lambda x: x + (I == N // 2)),
    "positions with one step alone": _position(lambda x: 1e-3 * (N // 2 < I)),
    "positions held": _position(lambda x: x[(I // 40) * 40]),
    "positions alternating": _position(lambda x: 1e-3 * SIGN),
    "positions of a saw": _position(lambda x: 1e-3 * (I % 3 - 1)),
    "positions random": _position(lambda x: 1e-3 * RANDOM),
    "positions missing": _position(lambda x: np.where(I % 3, x, np.nan)),
    "rest, then motion": _position(lambda x: np.where(N - 5 > I, 0.0, x)),
    "speed zero": _speed(np.zeros(1)),
    "speed tiny": _speed(np.array(1e-300)),
    "speed 1e-9 m/s": _speed(np.array(1e-9)),
    "speed 1e9 m/s": _speed(np.array(1e9)),
    "speed 1e300 m/s": _speed(np.array(1e300)),
    "speed alternating": _speed(0.02 * SIGN),
    "speed alternating and growing": _speed(0.02 * SIGN * (1 + I / N)),
    "speed of seven and one": _speed(np.where(I % 7 == 0, -0.02, 0.02)),
    "speed random": _speed(0.02 * RANDOM),
    "speed of one sample": _speed(0.02 * (N // 2 == I)),
    "speed over ten decades": _speed(10.0 ** np.linspace(-8, 2, N)),
    "speed missing": _speed(np.array(np.nan)),
}  # fmt: skip


def write(name: str, folder: Path) -> Path:
    """The file of one of them in `folder`, with its sidecar."""
    with np.errstate(all="ignore"):
        columns = usual() | dict(ODD[name](usual()))
    if "u" in columns:
        del columns["x"]
    path = folder / "odd.csv"
    header = ",".join(NAMES[each] for each in columns)
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, "%.17g", ",", header=header, comments="")
    path.with_suffix(".yaml").write_text(yaml.safe_dump({"sensor": SENSOR}))
    return path
