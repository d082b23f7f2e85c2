"""The files of a campaign in the folder of a fit, and its tables as text."""

from __future__ import annotations

import io

import pandas as pd
import pyarrow as pa
from pyarrow import csv

from bayes_rs.fits.columns import HYPER, TABLE
from bayes_rs.output import write_csv

TABLE_FILES = {TABLE: "campaign.csv", HYPER: "campaign-hyper.csv"}
"""The files of the campaign's tables."""
PRIOR_FILE = "campaign-prior.toml"
"""The prior that a campaign has learnt."""
ABOUT_FILE = "campaign.json"
"""What there is to say of a campaign. It is written last."""
FILES = (*TABLE_FILES.values(), PRIOR_FILE, ABOUT_FILE)
_TEXTS = ("quantity", "bin", "name", "interval")
_NUMBERS = (
    *("mean", "low", "high", "prob", "decided", "ess", "r_hat"),
    *("prior_mean", "prior_low", "prior_high"),
)
"""Columns of the tables, by what they hold: one that is empty has a type, too."""


def as_csv(table: pd.DataFrame) -> bytes:
    """Return a table as it is written."""
    sink = io.BytesIO()
    write_csv(table, sink, index=False)  # type: ignore[arg-type] # pandas writes to one as to a file
    return sink.getvalue()


def of_csv(content: bytes) -> pd.DataFrame:
    """Return a table as it is read: every number as it was written."""
    kinds = {**dict.fromkeys(_TEXTS, pa.string()), **dict.fromkeys(_NUMBERS, pa.float64()), "n_record": pa.int64()}
    options = csv.ConvertOptions(column_types=kinds, null_values=[""], strings_can_be_null=False)
    table: pd.DataFrame = csv.read_csv(pa.BufferReader(content), convert_options=options).to_pandas()
    return table


def as_read(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table as it will be read from its file."""
    return of_csv(as_csv(table))
