"""Records from radial velocities: variances, counts, flags, and the mean wind."""
