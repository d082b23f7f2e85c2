from .mann import MannTurbulence as MannTurbulence
from .mann import fit as fit
from .mann import load as load
from .two_point import cross_spectra as cross_spectra
from .two_point import velocity_covariance as velocity_covariance
