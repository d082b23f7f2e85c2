"""Where a command begins: `bayes-rs` and `python -m bayes_rs`."""

import atexit
import gc
import os
import signal
from types import FrameType

_NEW_OBJECTS = 100_000
"""Objects made, less those gone, before garbage is looked for. The memory of arrays does not wait for that."""


def main() -> None:
    """Run the command line, with what must be settled before anything else is loaded.

    Figures go to files, so `MPLBACKEND`, which notebooks set for all that they start, does not count. An interrupt
    while modules are loaded ends the program with one line, as it does later. What modules are made of stays: to look
    through all of it for garbage again and again, and once more at the end, would take a quarter of a short command.
    """
    gc.set_threshold(_NEW_OBJECTS, 10, 10)
    atexit.register(gc.freeze)  # the first one registered is the last one called
    os.environ["MPLBACKEND"] = "agg"
    handler = signal.getsignal(signal.SIGINT)
    if handler is signal.default_int_handler:  # in the background a shell has it ignored
        signal.signal(signal.SIGINT, _stop)
    from bayes_rs.cli import main as run  # noqa: PLC0415 - nothing is loaded before

    signal.signal(signal.SIGINT, handler)
    run()


def _stop(signum: int, frame: FrameType | None) -> None:  # noqa: ARG001 - as Python calls it
    """End at once: nothing has begun, and a library that is being loaded may swallow an exception."""
    try:
        os.write(2, b"\nbayes-rs: interrupted.\n")
    finally:
        os._exit(130)


if __name__ == "__main__":
    main()
