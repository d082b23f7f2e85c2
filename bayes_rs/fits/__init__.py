"""Fits of records, and what is read from them: summaries, directions, checks, figures."""
