"""The report: one HTML page from the output folder of a fit."""
