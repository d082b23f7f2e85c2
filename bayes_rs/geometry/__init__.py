"""Where the beams point, and what they see of R: stresses, probe volumes, scans, attitude, gradients."""
