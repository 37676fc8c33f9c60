"""Noise with signals of no interest beside it, of unknown sizes: the waves of mains.

Let W whiten the noise alone and C be the columns, whose sizes are normal of variance one. With the
singular values W C = U S V^T, of each row of data,

    (1 - U D U^T) W,    D = 1 - (1 + S^2)^(-1/2),

whitens both together: the sizes need not be fitted.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...compiled import compiled
from ...grid import as_real
from ...modules import with_fields
from ._noise import Whitener, WhitePlusOU, padded, whitener

NEGLIGIBLE_WAVE = 1e-6  # of the strongest wave, over the noise: what is less changes nothing


class WithNuisance(Whitener):
    """Noise `alone`, of rows that are independent, and columns (e, m, sample) beside it.

    `axes` (e, m, sample) are U^T, `strength` (e, m) is S, and `waves` (e, m, sample) are C V.
    """

    alone: Whitener
    axes: Float[Array, "e m sample"]
    strength: Float[Array, "e m"]
    waves: Float[Array, "e m sample"]

    @classmethod
    def of(cls, noise, columns: Float[np.ndarray, "e m sample"]) -> "WithNuisance":
        """That of `noise`, as [`fit`][] takes it, with these columns; where a sample is missing
        they count for nothing."""
        shape = columns.shape[0], columns.shape[2]
        alone, observed = whitener(noise, shape)
        columns = np.where(observed[:, None], columns, 0.0)
        whitened = np.asarray(_each(alone, as_real(columns.swapaxes(0, 1))))
        axes, strengths, waves = [], [], []
        for own, column in zip(whitened.swapaxes(0, 1), columns, strict=True):
            squares, turn = np.linalg.eigh(own @ own.T)
            strength = np.sqrt(
                np.maximum(squares, NEGLIGIBLE_WAVE**2 * max(squares.max(initial=0), 1.0))
            )
            axes.append(turn.T @ own / strength[:, None])
            strengths.append(strength)
            waves.append(turn.T @ column)
        return cls(alone, *(as_real(np.stack(each)) for each in (axes, strengths, waves)))

    @property
    def level_stderr(self):
        return self.alone.level_stderr

    @compiled
    def __call__(self, residual: Float[Array, "e sample"]) -> Float[Array, " n"]:
        return self._scaled(self.alone(residual), 1 / jnp.sqrt(1 + self.strength**2))

    def _scaled(self, white, factor: Float[Array, "e m"]) -> Float[Array, " n"]:
        """Whitened data, times a factor along each axis."""
        rows = white.reshape(self.axes.shape[0], -1)
        along = jnp.einsum("emn,en->em", self.axes, rows)
        return jnp.ravel(rows + jnp.einsum("em,emn->en", (factor - 1) * along, self.axes))

    def coloured(self, white: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "e sample m"]:
        """Inverse of whitening, of columns, where the noise alone has one."""
        assert isinstance(self.alone, WhitePlusOU)
        factor = jnp.sqrt(1 + self.strength**2)
        less = jax.vmap(lambda row: self._scaled(row, factor))(as_real(white.T))
        return self.alone.coloured(np.asarray(less).T)

    def without(
        self, y: Float[np.ndarray, "e sample"], seed: int = 0
    ) -> Float[np.ndarray, "e sample"]:
        """The data less sizes of the columns drawn from what `y` says of them, NaN where a sample
        is missing. Less the expected sizes they would have no noise along the columns."""
        missing = ~np.isfinite(y)
        white = np.asarray(self.alone(as_real(np.where(missing, 0.0, y)))).reshape(y.shape)
        strength, axes = np.asarray(self.strength), np.asarray(self.axes)
        drawn = np.random.default_rng(seed).normal(size=strength.shape)
        expected = strength * np.einsum("emn,en->em", axes, white)
        sizes = expected / (1 + strength**2) + drawn / np.sqrt(1 + strength**2)
        left = y - np.einsum("em,emn->en", sizes, np.asarray(self.waves))
        return np.where(missing, np.nan, left)

    def log_volume(self, shape: tuple[int, ...]) -> float:
        return self.alone.log_volume(shape) + float(
            np.sum(np.log1p(np.asarray(self.strength) ** 2)) / 2
        )

    def observed(self, shape: tuple[int, ...]) -> np.ndarray:
        return self.alone.observed(shape)

    def count(self, shape: tuple[int, ...]) -> int:
        return self.alone.count(shape)

    def filled_up(self, shape: tuple[int, ...], more: int) -> "WithNuisance | None":
        alone = self.alone.filled_up(shape, more)
        if alone is None:
            return None
        axes, waves = (padded(each, more, 0.0) for each in (self.axes, self.waves))
        return with_fields(self, alone=alone, axes=axes, waves=waves)


@compiled
def _each(alone: Whitener, columns: Float[Array, "m e sample"]) -> Float[Array, "m e sample"]:
    return jax.lax.map(lambda column: alone(column).reshape(column.shape), columns)
