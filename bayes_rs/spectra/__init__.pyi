from .along_wind import along_wind_spectra as along_wind_spectra
from .mann_fit import fit_spectra as fit_spectra
from .mann_fit import pool_length_scale as pool_length_scale
from .mann_fit import with_length_scale as with_length_scale
from .noise_estimate import estimate_instrument_noise as estimate_instrument_noise
from .noise_estimate import with_instrument_noise as with_instrument_noise
from .radial_spectrum import average_spectra as average_spectra
from .radial_spectrum import radial_spectra as radial_spectra
