from .corner_plot import corner as corner
from .lumley_plot import lumley as lumley
from .stresses_plot import stresses as stresses
