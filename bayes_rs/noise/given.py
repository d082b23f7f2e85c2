"""Noise that is given to a call: itself, or its file."""

from __future__ import annotations

from pathlib import Path

from bayes_rs.noise.noise import Noise


def given_noise(noise: Noise | str | Path | None) -> Noise | None:
    """Return noise that is given, itself or by its file; None if there is none.

    Raises
    ------
    InputError
        If it is of another kind, as a tuple, or the file is not one of noise.
    """
    if noise is None or isinstance(noise, Noise):
        return noise
    from bayes_rs.noise.file import as_noise  # noqa: PLC0415 - not needed without a file

    return as_noise(noise)
