"""The figures of the page and of the experiments. Nothing else in the package draws.

Each of the page's figures is drawn from the one dataset that holds every stage of a run, by
`name(dataset) -> Figure`; data missing from a dataset (a recording has no truth) are left out, or
noted in place of the figure. Components, methods and stresses have the same colours in all figures;
truth is black. The same input gives the same picture.
"""

from .compare import errors_against_noise as errors_against_noise
from .compare import ranking as ranking
from .contact import contact as contact
from .cost import accuracy_cost as accuracy_cost
from .cost import errors_and_time as errors_and_time
from .cost import fit_counts as fit_counts
from .coverage import bound_and_coverage as bound_and_coverage
from .coverage import confusion as confusion
from .coverage import evidence_margins as evidence_margins
from .coverage import normalised_errors as normalised_errors
from .curves import levels as levels
from .curves import stacked as stacked
from .estimates import averaging_kernel as averaging_kernel
from .estimates import estimates as estimates
from .feature import correlation as correlation
from .feature import feature_signals as feature_signals
from .feature import feature_traction as feature_traction
from .fit import residual as residual
from .fit import signals as signals
from .inspection import noise_spectra as noise_spectra
from .inspection import recorded_motion as recorded_motion
from .inspection import recorded_signals as recorded_signals
from .lines import channel_fits as channel_fits
from .lines import channel_pitches as channel_pitches
from .lines import line_spectrum as line_spectrum
from .lines import pattern_shifts as pattern_shifts
from .panels import Panel as Panel
from .panels import panels as panels
from .panels import stress as stress
from .panels import traction as traction
from .record import record as record
from .record import with_and_without as with_and_without
from .scene import scene as scene
from .spectra import filter_spectra as filter_spectra
from .spectra import spectra as spectra
