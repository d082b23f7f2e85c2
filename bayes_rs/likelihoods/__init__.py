"""Densities of the beams' variances, given R."""
