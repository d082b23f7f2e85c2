"""Long fits: part by part, by several workers, resumable."""
