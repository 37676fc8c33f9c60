"""The measured kernel of a recording's sensor, from passes over a known feature.

The traction is known but for the feature's place x0 and the friction mu. A fit of the rig finds
them, gains, depth, angles and offsets of the theory free beside them (see ../rig/calibration.py).
What it leaves uncertain of both moves the kernels, to first order by

    dK_p = K_p' dx0,    dK_q = K_q' dx0 - K_q dmu / mu,

as lags are counted from x0, and mu K_q is what the signals show. Passes of one way show the sum
K_p + mu K_q alone, of which mu is a name.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...errors import refuse
from ...forward.sensor import Sensor
from ...grid import as_real
from ...modules import with_fields
from ...numerics import root_of
from ...recording.passes import passes_of
from ...status import Status
from ..diagnostics import residual_over_noise
from ..estimate import averages
from ..gridding.pass_statistics import NOT_KNOWN
from ..line.model import FREEDOM, EstimateParts
from ..line.problem import LineProblem
from ..noise.nuisance import WithoutNuisance
from ..problem import Problem
from ..quality import Quality, quality, reasons
from ..rig.calibration import Calibration, calibrate
from .design import Weights
from .measure import measure_kernel
from .measured import MeasuredKernel
from .physics import Physics, default_parameters

PLACE, FRICTION = "position_m", "base_friction"
MOST_MOVED = 1.0  # relative error of mu, beyond which the first order is none
MOST_REST = 1.0  # of the theory's largest value: a theory that is a tenth off leaves a tenth
LEAST_FRICTION = 3.0  # standard errors of mu, below which nothing is measured of q


@dataclass(frozen=True)
class KernelResidual:
    """What a sensor's kernels leave of the mean signals over the known feature.

    `parts`: the fitted signal and the whitened residual (row, n); `chi2_per_freedom` of so many
    degrees of `freedom`, drift, mains and what passes may be off counted as noise.
    """

    parts: EstimateParts
    chi2_per_freedom: float
    freedom: float


@dataclass(frozen=True)
class FeatureKernel:
    """A kernel measured over a known feature.

    - `kernel`, of the sensor as it is `stated`; `calibration`: the fit that place and friction are
      of; `place_m`, `friction`: (value, standard error), zero where they are held.
    - `problem`: the recording's, `line_problem`: its signals on cells, the means over passes where
      it turns; `pressure_Pa` (n,): the known pressure there, less its background.
    """

    kernel: MeasuredKernel
    stated: Sensor
    calibration: Calibration
    place_m: tuple[float, float]
    friction: tuple[float, float]
    problem: Problem
    line_problem: LineProblem
    pressure_Pa: Float[np.ndarray, " n"]

    @cached_property
    def residual(self) -> KernelResidual:
        """What the kernel leaves."""
        return self._residual(self.kernel.sensor(self.stated), self.kernel.stats["resolved_dof"])

    @cached_property
    def residual_of_theory(self) -> KernelResidual:
        """What the sensor as stated leaves."""
        return self._residual(self.stated, 0.0)

    def _residual(self, sensor: Sensor, resolved_dof: float) -> KernelResidual:
        on = with_fields(self.problem, sensor=sensor, rig=None).to_grid()
        p = as_real(self.pressure_Pa)[None]
        clean = WithoutNuisance.of(on, p)
        parts = clean.problem.estimate_parts(p, jnp.zeros(p.shape))
        signal = np.asarray(parts.fitted) + np.asarray(clean.signal)
        residual = np.where(on.is_observed, np.asarray(on.data - on.forward(p)), 0.0)
        squares = float(np.sum(residual * Weights(on)(residual[None])[0]))
        offsets = len(residual) if on.has_free_offset else 0
        freedom = float(on.sample_count - offsets - resolved_dof)
        return KernelResidual(parts._replace(fitted=signal), squares / max(freedom, 1.0), freedom)

    @property
    def note(self) -> str:
        """How much the gain varies from pass to pass, as a sentence."""
        passes = self.line_problem.passes
        return passes.gains.note if passes else NOT_KNOWN

    @property
    def gain_spread(self) -> Float[np.ndarray, " e"]:
        """Rms by which the gain of each element varies from pass to pass, relative; NaN where it is
        not known."""
        passes, count = self.line_problem.passes, len(self.stated.elements)
        return passes.gains.spread if passes else np.full(count, np.nan)

    @property
    def status(self) -> Status:
        """How the fit of place and friction ended."""
        return self.calibration.status

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against the kernel's bands, as sentences."""
        passes = self.line_problem.passes
        return (
            *self.problem.warnings,
            *(passes.warnings_beside_gains if passes else ()),
            *self.kernel.warnings,
            *self._of_friction(),
            *self._of_rest(),
        )

    def _of_friction(self) -> tuple[str, ...]:
        if not self.kernel.has_both_ways:
            return ()
        value, error = self.friction
        fit = self.calibration.fit
        if abs(value) < LEAST_FRICTION * error or not value:
            return (
                f"The friction over the known feature is {value:.2g} ± {error:.2g}, consistent "
                "with zero. The kernel of q is therefore that of the prior, not a measurement. Use "
                "a feature with more friction.",
            )
        over = residual_over_noise(fit.known_chi2, fit.stats[FREEDOM])
        if not error or not over:
            return ()
        return (
            f"The friction {value:.3g} comes from a fit whose residual is "
            f"{np.sqrt(fit.known_chi2 or 0.0):.2g} times the noise. Its error, and that of the "
            "kernel of q, are larger than stated. If you know the friction, give "
            "fit.hold={base_friction: ...}.",
        )

    def _of_rest(self) -> tuple[str, ...]:
        rest = self.kernel.stats.get("rest_over_theory", 0.0)
        if rest < MOST_REST:
            return ()
        return (
            "The fitted theory explains little of the kernel: the remainder is "
            f"{rest:.2g} times the theory's largest value. Check the feature in fit.hold, its "
            "position and the order of the channels.",
        )

    @property
    def quality(self) -> Quality:
        """Good, doubtful or failed."""
        own = self.residual
        return quality(self.status, own.chi2_per_freedom, self.warnings, own.freedom)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the quality is not good, as sentences."""
        return reasons(self.status, self.warnings)


def measure_over_feature(
    problem: Problem,
    feature: Any,
    held: Mapping[str, float],
    free: Any = None,
    parameters: Sequence[str] | None = None,
) -> FeatureKernel:
    """The kernel of a recording's sensor from its passes over a known feature.

    - `problem`: with the sensor as it is stated.
    - `feature`, `held`, `free`: as [`calibrate`][] has them; `held` may name `base_friction` and
      `position_m`, too.
    - `parameters`: as [`measure_kernel`][] has them; None: a shift of all films, too, where the
      place is fitted.

    Raises `BadInput` for names that are not known, a feature that is not found, and a scan that is
    too short.
    """
    stated = problem.sensor
    # A film that is turned shows a feature elsewhere: beside a place that is fitted as if it were
    # not, its tilt is told only with a shift.
    shift = () if PLACE in held else ("shift_m",)
    names = (*default_parameters(stated), *shift) if parameters is None else parameters
    Physics(stated, names)
    calibration = calibrate(problem, feature, held, free)
    fitted = calibration.fit.value
    place, friction = (
        calibration.parameters.get(name, (float(fitted[name]), 0.0)) for name in (PLACE, FRICTION)
    )
    refuse(
        not place[1] < float(stated.depth_m),
        f"{problem.name}: the signals do not show where the known feature is, to "
        f"within a film depth: check fit.hold, or add {PLACE} to it.",
    )
    problem = with_fields(problem, friction=as_real(_sign(problem) * friction[0]))
    on = problem.to_grid()
    known = calibration.known.moved_to(place[0])
    pressure = np.asarray(averages(jnp.asarray(known.pressure_Pa)[None], known.line, on.line))[0]
    assert on.scan is not None
    assert on.friction is not None
    along = float(on.friction) * float(on.scan.direction)
    kernel = measure_kernel(on, stated, pressure, along, names)
    kernel = _with_errors(kernel, calibration, friction[0])
    return FeatureKernel(kernel, stated, calibration, place, friction, problem, on, pressure)


def _sign(problem: Problem) -> float:
    """Of what q over p is where friction is positive, of a motion that goes one way: a problem of
    one way of several turns it by itself."""
    every = passes_of(np.asarray(problem.motion.position_m))
    goes_back = problem.direction is None and not any(each.is_onwards for each in every)
    return -1.0 if goes_back else 1.0


def _with_errors(
    kernel: MeasuredKernel, calibration: Calibration, friction: float
) -> MeasuredKernel:
    """The kernel with the errors of place and friction in its own."""
    own = (PLACE, FRICTION) if kernel.has_both_ways else (PLACE,)
    names = [name for name in own if name in calibration.parameters]
    at = [list(calibration.parameters).index(name) for name in names]
    if not at:
        return kernel
    slope = np.gradient(kernel.value, kernel.lags.x_m, axis=-1)
    of_q = np.array([0.0, 1.0])
    relative = -of_q / friction if friction else -of_q
    moved = {
        PLACE: (slope, np.zeros(kernel.far.shape)),
        FRICTION: (kernel.value * relative[:, None], kernel.far * relative),
    }
    root = root_of(calibration.covariance[np.ix_(at, at)])
    if FRICTION in names:  # its error within its value
        row = names.index(FRICTION)
        error, most = float(np.linalg.norm(root[row])), MOST_MOVED * abs(friction)
        root[row] *= min(1.0, most / error) if error else 1.0
    factors, far = (
        np.einsum("ij,i...->j...", root, np.stack([moved[name][part] for name in names]))
        for part in (0, 1)
    )
    return dataclasses.replace(
        kernel,
        stderr=np.sqrt(kernel.stderr**2 + np.sum(factors**2, axis=0)),
        factors=np.concatenate([kernel.factors, factors]),
        far_factors=np.concatenate([kernel.far_factors, far]),
    )
