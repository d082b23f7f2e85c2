"""Commands about scans: those that there are, and the one that files were measured with."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bayes_rs.cli.completion import ScanName
from bayes_rs.cli.next_command import command_line, files_words, reading_words
from bayes_rs.cli.options import GroupedCommand, PictureFile, Quantity, settings_options
from bayes_rs.cli.voice import answer, note, tell, terminal_width

if TYPE_CHECKING:
    from bayes_rs.geometry.scan import Scan
    from bayes_rs.readers.survey import Survey

_SHARED = 0.8
"""Share of its own cycle's samples below which a scan shares the lidar's time: the default of ``min_availability``."""
_output = click.option("-o", "--output", type=PictureFile(), help="Picture to write (PNG, PDF or SVG).")
_overwrite = click.option("--overwrite", is_flag=True, help="Replace an existing file.")


@click.command()
@click.argument("name", required=False, type=ScanName())
@_output
@_overwrite
def scans(name: str | None, output: Path | None, overwrite: bool) -> None:
    """List the shipped scans and what each can see of the six stresses, or show one.

    NAME is one of the list, another name of it (windcube-nacelle, zxtm, ...), or a TOML file; changes follow an @, as
    in zx-tm@probe=point. It is shown with its beams, timing and probe volume; -o draws it.
    """
    from bayes_rs.geometry.scan_file import load_scan

    if name is None:
        if output is not None:
            raise click.UsageError("--output draws one scan: name it, as in bayes-rs scans zx-tm -o zx-tm.png.")
        _list_scans()
        return
    from bayes_rs.geometry.scan_words import WIDTH, scan_lines
    from bayes_rs.output import output_file

    scan = load_scan(name)
    if output is not None:
        with output_file(output, overwrite=overwrite) as part:
            from bayes_rs.plot.scan_plot import scan as draw_scan

            draw_scan(scan).savefig(part, dpi=130)
    for line in scan_lines(scan, width=terminal_width(WIDTH)):
        tell(line, wrap=False)
    if output is not None:
        tell(f"picture in {output}")
    answer({**_seen(scan), "title": scan.title, "source": scan.source, **({"file": str(output)} if output else {})})


def _list_scans() -> None:
    from bayes_rs.geometry.scan_file import load_scan
    from bayes_rs.models import preset_names

    tell(f"{'scan':<20}{'beams':>6}{'rank':>6}{'condition':>11}  what it sees of R", wrap=False)
    all_ = []
    for name in preset_names("scans"):
        scan = load_scan(name)
        seen = _seen(scan)
        all_.append(seen)
        start = f"{name:<20}{scan.n_beam:>6}{seen['rank']:>6}{seen['condition']:>11.1f}  "
        tell(start + seen["sees"], indent=len(start))
    tell()
    tell(
        "rank: independent directions of R that the beams see, of 6; condition: largest over smallest singular value "
        "of what is seen. Any scan takes --opening-angle, --focus-distance, --tilt and --yaw. The scans of instruments "
        "have a probe volume; behind a name, @probe=point takes it away.",
        indent=0,
    )
    tell("bayes-rs scans NAME shows one, with its beams; bayes-rs find-scan makes one from files.", indent=0)
    answer({"scans": all_})


def _seen(scan: Scan) -> dict[str, Any]:
    """Return what a scan is and sees, as plain values."""
    from bayes_rs.geometry.forward import sight

    seen = sight(scan)
    return {
        "name": scan.name,
        "n_beam": scan.n_beam,
        "rank": seen.rank,
        "condition": float(seen.condition),
        "sees": seen.in_words(),
    }


@click.command(name="find-scan", cls=GroupedCommand)
@click.argument("files", nargs=-1, required=True, metavar="FILES...", type=click.Path())
@settings_options("scan", "files", only={"scan": ("scan_group",)})
@click.option(
    "--tolerance",
    "tolerance_deg",
    type=Quantity("tolerance", "degrees"),
    default=1.0,
    show_default=True,
    help="Rays that are closer than this, degrees, have one direction.",
)
@click.option(
    "--min-share",
    type=Quantity("min_share", zero=True),
    default=0.2,
    show_default=True,
    help="Directions with fewer rays than this share of the most frequent one are dropped.",
)
@click.option("--probe", metavar="NAME", help="Scan whose probe volume the beams have; by default they are points.")
@click.option(
    "--probe-gate-length",
    type=Quantity("gate_length", "m"),
    help="Length of the gates of a pulsed lidar, m: the probe volume of its beams.",
)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Scan file to write (.toml).")
@_overwrite
def find_scan(
    files: tuple[str, ...],
    tolerance_deg: float,
    min_share: float,
    probe: str | None,
    probe_gate_length: float | None,
    output: Path,
    overwrite: bool,
    **options: Any,
) -> None:
    """Make the scan that files were measured with, from their own directions, times and gates.

    FILES are files, folders or patterns, in a format whose rays say where they point: WindCube, e-WindLidar, Halo and
    others. Where they hold several scans, those are listed, and the one that has beams is taken.
    """
    from bayes_rs.cli.options import settings_of
    from bayes_rs.errors import InputError
    from bayes_rs.file_options import ALL_RANGES
    from bayes_rs.fits.found_scan import distances, survey_options
    from bayes_rs.geometry.probe import make_probe
    from bayes_rs.geometry.scan_file import as_probe
    from bayes_rs.geometry.scan_writing import save_scan
    from bayes_rs.output import output_file
    from bayes_rs.readers.survey import survey

    if probe is not None and probe_gate_length is not None:
        raise click.UsageError("--probe and --probe-gate-length say the same: give one of the two.")
    if output.suffix != ".toml":
        raise InputError(f"Invalid scan file {str(output)!r}: its name must end in .toml; add the ending.")
    settings = settings_of((), options)
    with output_file(output, overwrite=overwrite, inputs=files) as part:
        own = None if probe is None else as_probe(probe)
        own = own if probe_gate_length is None else make_probe("pulsed", gate_length=probe_gate_length)
        found = survey(
            list(files),
            height=distances(settings.files.height) or None,
            distance=distances(settings.files.range) or None,
            any_gate=settings.files.range == ALL_RANGES,
            group=settings.scan.scan_group,
            tolerance_deg=tolerance_deg,
            min_share=min_share,
            name=output.stem,
            probe=own,
            **survey_options(settings.files),
        )
        save_scan(found.scan, part.with_suffix(".toml")).replace(part)
    _tell(found, files, output, options)


def _tell(found: Survey, files: tuple[str, ...], output: Path, options: dict[str, Any]) -> None:
    """Say what was found, what was dropped, and what to type next."""
    from bayes_rs.geometry.forward import sight
    from bayes_rs.geometry.scan_words import RECORD, beam_table, probe_in_words
    from bayes_rs.records.report import LEAST_TAKEN

    scan = found.scan
    tell(f"{output}: {scan.n_beam} beams, from {scan.source}")
    for line in beam_table(scan, {"rays": [str(count) for count in found.n_ray]}):
        tell(line, wrap=False)
    every = RECORD / scan.scan_duration
    tell(f"cycle of {scan.scan_duration:g} s: {every:.3g} samples of a beam in {RECORD:g} s")
    least, usual, most = found.in_record
    shared = usual < _SHARED * every
    if shared:
        span = f"{least:g} to {most:g}, usually {usual:g}" if least < most else f"{usual:g}"
        tell(
            f"in these files {span}: the lidar shares its time, and records need "
            f"{100.0 * _SHARED:g} % of them, or a lower --min-availability (docs/quality.md)"
        )
    tell(f"probe volume: {probe_in_words(scan.probe, scan.focus_distance)}")
    tell(sight(scan).in_words())
    for index, line in enumerate(found.found.in_words()):
        if index != found.chosen:
            tell(f"not of this scan: {line}")
    reasons = Counter(found.found.skipped.values())
    for path, reason in found.found.skipped.items():
        if reasons.pop(reason, 0):
            note(f"file {path.name}: {reason}")
    others = [path for index, one in enumerate(found.found.groups) if index != found.chosen for path in one.files]
    named = files_words(files, found.files, [*others, *found.found.skipped])
    where = {name: value for name, value in options.items() if name in ("range", "height")}
    reading = reading_words({name: value for name, value in options.items() if name not in ("on_bad_file", *where)})
    if named is None:
        wanted = reading_words(where)
        group = ["--scan-group", str(found.chosen + 1)] if options["scan_group"] else []
        which = [*files, "--scan", "auto", *wanted, *group]
    else:
        which = [*named, "--scan", str(output)]
    if shared and usual >= LEAST_TAKEN:
        which += ["--min-availability", f"{math.floor(20.0 * usual / every) / 20.0:g}"]
    following = command_line("bayes-rs", "fit", *which, *reading, "-o", "OUT/")
    tell(f"next: {following}", wrap=False)
    rays = [int(count) for count in found.n_ray]
    answer({"file": str(output), **_seen(scan), "source": scan.source, "rays": rays, "next": following})


@click.command(cls=GroupedCommand)
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path())
@settings_options("files")
@_output
@_overwrite
def look(files: tuple[str, ...], output: Path | None, overwrite: bool, **options: Any) -> None:
    """Say what is in files, before a scan or any option is known, and what to type next.

    Format and the options that it assumes, beams or directions with their samples, gates, sampling, gaps, what is
    missing, and what the sign says; of a table its headings with what they seem to be; of a cone the mean velocity
    over the phase with the phase zeros that there may be. Of many files twenty are read, of a long table the first
    200 000 rows. A file - is the standard input: a table of text.
    """
    from bayes_rs.cli.options import settings_of
    from bayes_rs.output import output_file
    from bayes_rs.readers.looking import look as look_at
    from bayes_rs.readers.standard_input import with_standard_input

    given = settings_of((), options).files.of_reading()
    with with_standard_input(files) as named:
        found = look_at(named, **{name: value for name, value in given.items() if name != "on_bad_file"})
    words = dict(zip(named, files, strict=True))  # what to type next has the names that were given
    if output is not None:
        with output_file(output, overwrite=overwrite) as part:
            from bayes_rs.plot.look_plot import draw_look

            draw_look(found).savefig(part, dpi=130)
    for line in found.lines:
        tell(line, wrap=not line.startswith(" "))
    if output is not None:
        tell(f"picture in {output}")
    where = {name: value for name, value in options.items() if name in ("range", "height")}
    reading = reading_words({name: value for name, value in options.items() if name not in ("on_bad_file", *where)})
    following = [words.get(word, word) for word in ("bayes-rs", *found.words[:-2], *reading, *found.words[-2:])]
    tell(f"next: {command_line(*following)}", wrap=False)
    answer({"lines": list(found.lines), "next": command_line(*following)})
