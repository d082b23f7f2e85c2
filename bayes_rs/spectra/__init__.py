"""Spectra of radial velocities: what they say about the length scale of the turbulence and the instrument's noise."""
