"""Scans compared, traded off and chosen by what they tell of R."""
