"""Noise made, kept and chosen: by theory or in boxes, banks over states of the wind, the cache."""
