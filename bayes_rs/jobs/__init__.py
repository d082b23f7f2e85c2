"""Whole jobs: files in, a folder of results out."""
