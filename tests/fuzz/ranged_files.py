"""Records and fits at several ranges that come back in changed."""

import shutil
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import xarray as xr

import bayes_rs as brs
from bayes_rs.output import write_netcdf
from fuzz.frame import Case, command, python
from fuzz.own_files import _change, reseal, scene

DISTANCES = (52.0, 70.0)
SCAN = "6-beam@opening_angle_deg=45,focus_distance=52"
EFFORT = {"target_ess": 100, "sampler": "direct", "seed": 1, "campaign": "off", "turbulence": "fu-2022"}


@cache
def ranged_scene() -> Path:
    """Make a folder with records at two ranges, and a fit of them."""
    scene()  # its cache of noise, and little effort
    place = Path(tempfile.mkdtemp(prefix="fuzz-ranged-"))
    series = brs.read(brs.demo_file("6-beam-45"), SCAN)
    both = [series.assign_coords(range=("sample", np.full(series.sizes["sample"], one))) for one in DISTANCES]
    records = brs.make_records(xr.concat(both, dim="sample").drop_attrs(), SCAN)
    write_netcdf(records, place / "records.nc")
    brs.fit(records, SCAN, output=place / "fit", **EFFORT)
    return place


def _everything(folder: Path) -> None:
    """Open the fit and ask for everything."""
    found = brs.open_fit(folder / "fit")
    for one in (
        found.summary,
        lambda: found.summary(prob=0.5),
        found.profile,
        lambda: found.profile(1),
        lambda: found.at(70.0).draws(1),
        found.campaign,
        found.to_arviz,
        lambda: (found.words, found.failures, found.remarks, found.flags, found.n_fitted, repr(found), found.attrs),
        lambda: found.records,
        lambda: brs.plot.profile(found),
    ):
        try:
            one()
        except brs.InputError as error:
            text = str(error)
            if not text.strip() or "\n" in text or len(text) > 2000:
                raise AssertionError(f"not one line: {text[:300]!r}") from error


def _case(rng: np.random.Generator, name: str, seed: int) -> Case:
    made = ranged_scene()
    by_bytes, sealed = rng.random() < 0.2, rng.random() < 0.8
    if rng.random() < 0.4:
        file, how = "records.nc", int(rng.integers(2))
        run = [
            command("fit", "records.nc", "--scan", SCAN, "--ess", "100", "--sampler", "direct", "--seed", "1",
                    "--no-campaign", "--turbulence", "fu-2022", "-o", "out"),
            command("records", "records.nc", "--scan", SCAN, "-o", "again.nc"),
        ][how]  # fmt: skip
    else:
        names = sorted(
            path.relative_to(made).as_posix()
            for path in (made / "fit").rglob("*")
            if path.suffix in (".json", ".jsonl")
        )
        file, how = names[rng.integers(len(names))], int(rng.integers(3))
        run = [command("report", "fit", "--overwrite"), command("corner", "fit", "--range", "70"), python(_everything)][
            how
        ]

    def whole(folder: Path) -> int | None:
        if file == "records.nc":
            shutil.copy(made / file, folder / file)
        else:
            shutil.copytree(made / "fit", folder / "fit")
        _change(folder / file, np.random.default_rng(seed), by_bytes=by_bytes)
        if sealed and file.endswith(".json"):
            reseal((folder / file).parent)
        return run(folder)

    return Case(f"{name} {file}{' bytes' if by_bytes else ''}{' sealed' if sealed else ''} how={how}", whole)


def cases(seed: int, n: int) -> Iterator[Case]:
    """Give so many cases; the same ones for the same seed."""
    for number in range(n):
        rng = np.random.default_rng([seed, number])
        yield _case(rng, f"ranged {seed}/{number}", int(rng.integers(2**31)))
