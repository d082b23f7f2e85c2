from ..design.comparison_plot import comparison as comparison
from ..spectra.spectra_plot import spectra as spectra
from .corner_plot import corner as corner
from .lumley_plot import lumley as lumley
from .stresses_plot import stresses as stresses
