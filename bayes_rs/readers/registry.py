"""The formats of files, by name."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayes_rs.registry import Registry

if TYPE_CHECKING:
    from bayes_rs.readers.interface import Reader

READERS: Registry[Reader] = Registry(
    {
        "halo": "bayes_rs.readers.halo:READER",
        "windcube-text": "bayes_rs.readers.windcube_text:READER",
        "galion": "bayes_rs.readers.galion:READER",
        "windscanner": "bayes_rs.readers.windscanner:READER",
        "zx": "bayes_rs.readers.zx:READER",
        "spinnerlidar": "bayes_rs.readers.spinnerlidar:READER",
        "molas": "bayes_rs.readers.ray_table:MOLAS",
        "rays": "bayes_rs.readers.ray_table:READER",
        "long": "bayes_rs.readers.long_table:READER",
        "wide": "bayes_rs.readers.wide_table:READER",
        "windcube": "bayes_rs.readers.windcube:READER",
        "e-windlidar": "bayes_rs.readers.e_windlidar:READER",
        "arm": "bayes_rs.readers.arm:READER",
        "cfradial": "bayes_rs.readers.cfradial:READER",
        "netcdf": "bayes_rs.readers.netcdf:READER",
    }
)
"""Every format by its name, the special ones before the general ones: the first that recognises a file reads it."""


class _Formats:
    """What the option file_format may be: auto, and the names of the readers that there are now."""

    def __iter__(self) -> Iterator[str]:
        return iter(("auto", *READERS))


FORMATS = _Formats()
"""The values of the option file_format."""
