"""This system made like Windows, as far as that can be: what is missing there is gone, what is refused there is.

Run as a script, it fits two records into a folder, resumes and replaces it, with nothing of what only POSIX has.
"""

import errno
import importlib
import os
import signal
import sys
import types
from pathlib import Path

FOLDER = Path("/proc/self/fd")
MISSING = ("sysconf", "getuid", "geteuid", "register_at_fork", "sched_getaffinity", "getloadavg", "fork")
LOCKED = []
OURS = [f"bayes_rs.{name}" for name in ("folder_lock", "ledger", "folder_place", "sizes", "processor")]
OURS += ["bayes_rs.readers.netcdf_process"]
"""What asks for the system."""


def in_use(path):
    """Whether this process has a file open that is at a path or below it."""
    place = os.path.realpath(path)
    for entry in FOLDER.iterdir():
        try:
            target = str(entry.readlink())
        except OSError:
            continue
        if target == place or target.startswith(place + os.sep):
            return True
    return False


def refuse(path):
    raise PermissionError(errno.EACCES, "The process cannot access the file because it is being used", str(path))


def as_on_windows():
    """To be called after the libraries are imported, which know which system they are on, and before ours is."""
    import fcntl  # noqa: PLC0415 - to be taken away

    plain = {name: getattr(os, name) for name in ("replace", "rename", "unlink", "fsync")}

    def moved(name):
        def move(source, target, **options):
            if Path(target).is_dir() or in_use(source) or (Path(target).exists() and in_use(target)):
                refuse(target)
            plain[name](source, target, **options)

        return move

    def unlink(path, **options):
        if "dir_fd" not in options and in_use(path):
            refuse(path)
        plain["unlink"](path, **options)

    def fsync(number):
        if fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")
        plain["fsync"](number)

    def locking(number, mode, n_byte):
        at = (os.fstat(number).st_ino, os.lseek(number, 0, os.SEEK_CUR), n_byte)
        if mode == msvcrt.LK_NBLCK:
            if at in LOCKED:
                raise PermissionError(errno.EACCES, "Permission denied")
            LOCKED.append(at)
        else:
            LOCKED.remove(at)

    msvcrt = types.ModuleType("msvcrt")
    msvcrt.LK_NBLCK, msvcrt.LK_UNLCK, msvcrt.locking = 2, 0, locking
    sys.modules |= {"msvcrt": msvcrt, "_winapi": types.ModuleType("_winapi")}
    import resource  # noqa: PLC0415 - to be taken away

    sys.modules |= {"fcntl": None, "resource": None}
    os.replace, os.rename = moved("replace"), moved("rename")
    os.unlink = os.remove = unlink
    os.fsync = fsync
    for name in MISSING:
        if hasattr(os, name):
            delattr(os, name)
    for name in ("SIGHUP", "SIGALRM", "setitimer", "ITIMER_REAL"):
        delattr(signal, name)
    platform, sys.platform = sys.platform, "win32"
    for name in OURS:
        importlib.import_module(name).sys = Windows()
    sys.platform = platform  # other libraries go on as they are
    sys.modules |= {"fcntl": fcntl, "resource": resource}


class Windows:
    """The module `sys`, of another system."""

    platform = "win32"

    def __getattr__(self, name):
        return getattr(sys, name)


def main(place):
    """Fit, resume, replace and read again; print what the numbers are."""
    for name in ("h5netcdf", "loky", "matplotlib.pyplot", "pandas", "pyarrow.parquet", "scipy.stats", "xarray"):
        importlib.import_module(name)
    as_on_windows()
    import scenes  # noqa: PLC0415

    import bayes_rs as brs  # noqa: PLC0415
    from bayes_rs.folder_lock import locked  # noqa: PLC0415
    from bayes_rs.output import output_folder, write_run  # noqa: PLC0415

    scan, stress = brs.load_scan("6-beam"), [[1.0, 0.6, 0.4, 0.0, -0.2, 0.0]] * 2
    noise = scenes.plain_noise(scan)
    records = scenes.records_of(stress @ brs.geometry.design_matrix(scan).T, scan)
    options = {"noise": noise, "seed": 1, "target_ess": 100}
    brs.fit(records, scan, output=place / "out", **options)
    brs.fit(records, scan, output=place / "out", resume=True, **options)
    other = brs.fit(records, scan, output=place / "out", overwrite=True, **{**options, "seed": 2})
    assert other.run["settings"]["fit"]["seed"] == 2
    brs.write_report(place / "out", place / "page.html")
    brs.save_scan(scan, place / "scan.toml")
    for number in range(2):
        with output_folder(place / "table", overwrite=number > 0) as folder:
            write_run(folder, {"number": number})
        (place / "table" / "mine.txt").touch(exist_ok=True)
        (place / "table" / "mine.txt").unlink()
    with locked(place / "out"):
        try:
            brs.fit(records, scan, output=place / "out", resume=True, **options)
        except brs.InputError as error:
            assert "is being written by another run" in str(error)  # noqa: PT017 - no test, a script
        else:
            raise AssertionError("a second run was let in")
    assert LOCKED == []
    for name, words in (("nul.2020", "the name of a device"), ("a:b", "on Windows a name"), ("year.", "on Windows")):
        try:
            brs.fit(records, scan, output=place / name, **options)
        except brs.InputError as error:
            assert words in str(error)  # noqa: PT017
        else:
            raise AssertionError(name)
    print(brs.open_fit(place / "out").summary()["mean"].tolist())  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
