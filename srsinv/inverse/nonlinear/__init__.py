"""The general nonlinear fit under every fit of features: `srsinv.fit`."""

from ._answer import Fit as Fit
from ._fit import fit as fit
from ._fit import fit_many as fit_many
from ._jaxopt import JaxoptLBFGSB as JaxoptLBFGSB
from ._loss import Cauchy as Cauchy
from ._loss import Huber as Huber
from ._loss import Loss as Loss
from ._loss import SoftL1 as SoftL1
from ._loss import Squares as Squares
from ._noise import LEVEL_STDERR as LEVEL_STDERR
from ._noise import Correlated as Correlated
from ._noise import Independent as Independent
from ._noise import Spectrum as Spectrum
from ._noise import WhitePlusOU as WhitePlusOU
from ._noise import whitener as whitener
from ._nuisance import WithNuisance as WithNuisance
from ._sampler import check_sampler as check_sampler
from ._samples import PosteriorSamples as PosteriorSamples
from ._sampling import LEAST_DRAWS as LEAST_DRAWS
from ._sampling import FitToSample as FitToSample
from ._sampling import sample as sample
from ._solvers import Minimum as Minimum
from ._solvers import OptaxLBFGS as OptaxLBFGS
from ._solvers import Optimistix as Optimistix
from ._solvers import Solver as Solver
from ._traced import TracedFit as TracedFit
