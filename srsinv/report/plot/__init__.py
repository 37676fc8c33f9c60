"""The figures of pages, public as `srsinv.plot`: each takes the dataset of a result.

They work on what a run leaves, `srsinv.plot.estimates(xarray.open_dataset("result.nc"))`, too;
`answer`, `estimates` and `fit` also on estimates and fits themselves.
Components, methods and stresses have the same colours in all figures; truth is black. The same
input gives the same picture. Figures of one experiment alone stand beside it, made of `Panel`s.
"""

from .answer import answer as answer
from .budget import budget as budget
from .contact import contact as contact
from .contact import feature_traction as feature_traction
from .cost import cost as cost
from .curves import curves as curves
from .curves import panel as panel
from .estimates import averaging_kernel as averaging_kernel
from .estimates import estimates as estimates
from .long import extremes as extremes
from .long import in_columns as in_columns
from .matrix import matrix as matrix
from .panels import Curve as Curve
from .panels import Mark as Mark
from .panels import Panel as Panel
from .panels import PanelAxis as PanelAxis
from .panels import panels as panels
from .passes import passes as passes
from .quantiles import quantiles as quantiles
from .scene import scene as scene
from .signals import fit as fit
from .signals import residual as residual
from .signals import signals as signals
from .spectra import spectra as spectra
from .spread import spread as spread
from .stages import record as record
from .stages import stress as stress
from .stages import traction as traction
from .stages import with_and_without as with_and_without
from .sweep import sweep as sweep
