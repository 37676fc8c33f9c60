"""Features of traction and of a surface: one model, one search, one fit.

The two differ in how a feature loads the skin (loading.py): by itself, or through the skin's
contact with the surface.
"""

from .estimate import FeatureEstimate as FeatureEstimate
from .estimate import probabilities as probabilities
from .fit import FeatureFitter as FeatureFitter
from .method import FeatureFit as FeatureFit
from .model import FeatureModel as FeatureModel
