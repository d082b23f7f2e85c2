from .campaign_plot import campaign as campaign
from .corner_plot import corner as corner
from .lumley_plot import lumley as lumley
from .of_others import comparison as comparison
from .of_others import spectra as spectra
from .profile_plot import profile as profile
from .scan_plot import scan as scan
from .stresses_plot import stresses as stresses
