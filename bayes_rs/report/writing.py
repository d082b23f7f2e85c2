"""The report of a fit, as a file."""

from __future__ import annotations

from pathlib import Path

from bayes_rs.output import output_file
from bayes_rs.report.folder import read_folder
from bayes_rs.report.page import render

REPORT_FILE = "report.html"


def write_report(
    folder: str | Path,
    output: str | Path | None = None,
    *,
    title: str | None = None,
    prob: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Write one HTML page that shows what a fit found, with its pictures and everything they are drawn from.

    Parameters
    ----------
    folder : str or Path
        Output folder of `run_fit`, of `fit_campaign` or of ``bayes-rs fit``.
    output : str or Path, optional
        File to write; by default ``report.html`` in the folder.
    title : str, optional
        Heading of the page; by default the scan and the period.
    prob : float, optional
        Probability of the credible intervals; by default that of the folder's summary. Another one needs the draws of
        ``posterior.nc``.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    file : Path
        The page.

    Raises
    ------
    InputError
        If the folder is not of a fit, the file exists and may not be replaced, or prob cannot be had.

    Notes
    -----
    The page loads nothing from elsewhere, and the same folder gives the same bytes. Of more than 1000 records the
    pictures along time show bins of whole hours. Draws go with the page as far as they take less than about 2.4 MB, 100
    to 600 a record; beyond, the posterior of a record is drawn from its mean and covariance, as a Gaussian. Where a
    folder has no rows for it, turbulence intensity is √uu/U of the ends of the interval of uu: it holds the same
    probability, but is not the shortest one.

    Examples
    --------
    >>> import tempfile, bayes_rs as brs
    >>> scan = brs.load_scan("6-beam", opening_angle_deg=45.0, focus_distance=52.0)
    >>> records = brs.make_records(brs.read(brs.demo_file("6-beam-45"), scan), scan)
    >>> noise = brs.calibrate(scan, brs.load_turbulence("fu-2022"), wind_speed=10.0, cache=False)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     campaign = brs.fit_campaign(records, scan, f"{folder}/hour", noise=noise, seed=1)
    ...     file = write_report(campaign.folder)
    ...     file.name, "Stresses over time" in file.read_text(encoding="utf-8")
    ('report.html', True)
    """
    file = Path(folder) / REPORT_FILE if output is None else Path(output)
    found = read_folder(folder, prob=prob)
    with output_file(file, overwrite=overwrite) as part:
        part.write_text(render(found, title=title), encoding="utf-8", newline="\n")
    return file
