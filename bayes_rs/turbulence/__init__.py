"""The Mann model: spectral tensor, stresses at a point, covariances of two points."""
