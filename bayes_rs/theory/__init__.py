"""Covariances along beams in Mann turbulence: of sampled radial velocities, and of what a sonic sees with them."""
