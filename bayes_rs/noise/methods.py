"""How noise can be made, by name."""

from __future__ import annotations

METHODS = ("theory", "boxes")
"""From closed forms of Gaussian turbulence, or from realizations of it in boxes."""
