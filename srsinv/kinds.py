"""The bases of all kinds of parts that a configuration may name, in one public module.

Derive from one, in the package or in a file of your own, and name the class by `_target_` in a YAML
file of the kind's group: docs/how_to/write_other_parts.md has an example of each.
"""

from typing import TYPE_CHECKING

from .targets import KINDS, base_of

if TYPE_CHECKING:  # for editors and type checkers, which cannot read the table
    from .effects import Effect as Effect
    from .forward.amplifier import Amplifier as Amplifier
    from .forward.envelope import Envelope as Envelope
    from .forward.feature import Feature as Feature
    from .forward.film import LineEffect as LineEffect
    from .forward.filter import Filter as Filter
    from .forward.noise import Noise as Noise
    from .forward.scan import ConstantSpeed as ConstantSpeed
    from .forward.scene import Scene as Scene
    from .forward.shape import Shape as Shape
    from .forward.skin import HalfSpace as HalfSpace
    from .forward.skin import Skin as Skin
    from .forward.speed_profile import SpeedProfile as SpeedProfile
    from .forward.surface import Rough as Rough
    from .forward.surface_feature import SurfaceFeature as SurfaceFeature
    from .forward.traction import FrictionStep as FrictionStep
    from .forward.traction import Pressure as Pressure
    from .grid import Operator as Operator
    from .inverse.kernel.operator_model import OperatorModel as OperatorModel
    from .inverse.line.constraint import Constraint as Constraint
    from .inverse.line.prior import Prior as Prior
    from .inverse.line.rule import Rule as Rule
    from .inverse.method import Method as Method
    from .inverse.nonlinear import Solver as Solver
    from .inverse.wiener import TractionSpectrum as TractionSpectrum
    from .recording.reader import Reader as Reader
    from .report.section import Section as Section

_BASES = {name.rpartition(".")[2]: name for names in KINDS.values() for name in names}
__all__ = sorted(_BASES)  # pyright: ignore[reportUnsupportedDunderAll]


if not TYPE_CHECKING:  # to a type checker every name would exist

    def __getattr__(name: str) -> type:
        if name in _BASES:  # when it is asked for, as most import jax
            return base_of(_BASES[name])
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
