"""Geometry in the field and the mean wind: attitude, mean wind and its error, profiles, motion, beam pairs, frames."""
