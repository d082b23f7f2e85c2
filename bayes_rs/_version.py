"""The version of bayes_rs, written once."""

__version__ = "0.1.0"
