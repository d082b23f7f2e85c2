"""What a fit hands out without a copy: it can be looked at, and not changed, so that the fit stays what it was."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """Return the same numbers as an array that cannot be written.

    Parameters
    ----------
    values : ndarray
        The numbers; what holds them may still write them.

    Examples
    --------
    >>> import numpy as np
    >>> read_only(np.zeros(2)).flags.writeable
    False
    """
    view = values.view()
    view.flags.writeable = False
    return view


def read_only_dataset(dataset: xr.Dataset) -> xr.Dataset:
    """Return a Dataset of the same arrays, which cannot be written; variables and attributes can be put in place of it.

    Parameters
    ----------
    dataset : Dataset
        The Dataset; it stays as it is.
    """
    found = dataset.copy(deep=False)
    for variable in found.variables.values():
        if not isinstance(variable, xr.IndexVariable) and isinstance(variable.data, np.ndarray):
            variable.data = read_only(variable.data)  # an index cannot be written as it is
    return found
