"""The five features of traction, everything about them to be found."""

from srsinv.forward.feature import (
    GratingFeature,
    HertzFeature,
    LineFeature,
    StepFeature,
    StripFeature,
)

FEATURES = {
    "line": LineFeature(),
    "strip": StripFeature(),
    "hertz": HertzFeature(),
    "step": StepFeature(),
    "grating": GratingFeature(),
}
