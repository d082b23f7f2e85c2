"""The tables of a fit in its folder: what their columns are, and which rows they must have."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from bayes_rs.errors import InputError
from bayes_rs.fits.campaign_files import TABLE_FILES, of_csv
from bayes_rs.fits.columns import (
    ALONG,
    ALONG_SHAPE,
    CORRELATED,
    COVARIANCES,
    HYPER,
    PAIRS,
    PATTERN,
    PER_RECORD,
    SUMMARY,
    TABLE,
    VARIANCES,
    pattern_columns,
)
from bayes_rs.fits.flags import UNFITTED
from bayes_rs.fits.run_file import RunOfFit
from bayes_rs.fits.summarizing import COLUMNS
from bayes_rs.fits.tables import ADVICE, part_names, read_table
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.layouts import check_table
from bayes_rs.result_folder import ResultFolder

DATASETS = ("summary", "posterior", "draws", "predicted", SUMMARY, VARIANCES, PATTERN)
"""The tables in parts."""
_WHERE = {"record": "whole", "time": "time"}
_DRAW = {"record": "whole", "chain": "whole", "draw": "whole"}
_SUMMARY = {
    **dict.fromkeys(COLUMNS, "number"),
    **dict.fromkeys(("mean", "median", "low", "high", "least_squares"), "amount"),
    **dict.fromkeys(("sd", "prob", "ess_bulk", "ess_tail"), "size"),
    **_WHERE,
    "stress": "text",
    "interval": "text",
    "flag": "text",
}
_POSTERIOR = {
    **_WHERE,
    "flag_bits": "whole",
    "sampler": "text",
    "outside_noise": "truth",
    **dict.fromkeys(PER_RECORD, "number"),
    **{name: "size" if i == j else "amount" for name, (i, j) in zip(COVARIANCES, PAIRS, strict=True)},
    **dict.fromkeys((*ALONG, *ALONG_SHAPE), "amount"),
    **dict.fromkeys(CORRELATED, "number"),
    "beams_words": "text",
}
_OF_CAMPAIGN = ("mean", "low", "high", "decided")
_CAMPAIGN = {
    TABLE: {
        "quantity": "text",
        "bin": "text",
        **dict.fromkeys(_OF_CAMPAIGN, "amount"),
        "prob": "size",
        "interval": "text",
        "n_record": "whole",
    },
    HYPER: {
        "name": "text",
        **dict.fromkeys((*_OF_CAMPAIGN, "prior_mean", "prior_low", "prior_high"), "amount"),
        "interval": "text",
        "ess": "size",
        "r_hat": "number",
    },
}
_PART = re.compile(r"part-(\d+)\.parquet")
_AT_ONCE = 16_384
"""Records of which a table is in memory at a time, where it is read piece by piece."""
_WHOLE = (*STRESSES, "ti", "ti_p90")
"""Quantities that a campaign has over all its records."""


@dataclass(frozen=True, eq=False)
class FolderTables:
    """Tables in a folder of results, in parts of so many records.

    Parameters
    ----------
    folder : ResultFolder
        The folder.
    run : RunOfFit
        What its `run.json` says.
    beams : sequence of int
        Numbers of the beams.
    """

    folder: ResultFolder
    run: RunOfFit
    beams: Sequence[int]

    @cached_property
    def _names(self) -> dict[str, list[str]]:
        found = {dataset: part_names(self.folder, dataset) for dataset in DATASETS}
        here = self.folder.names()
        found |= {dataset: [name] for dataset, name in TABLE_FILES.items() if name in here}
        return {dataset: names for dataset, names in found.items() if names}

    @cached_property
    def _of_part(self) -> dict[str, dict[int, list[str]]]:
        """The files of each part of each table, in the order of their months."""
        found: dict[str, dict[int, list[str]]] = {}
        for dataset, names in self._names.items():
            of_part = found.setdefault(dataset, {})
            for name in names if dataset not in _CAMPAIGN else ():
                if (part := _PART.fullmatch(name.rsplit("/", 1)[-1])) is not None:
                    of_part.setdefault(int(part[1]), []).append(name)
        return found

    @property
    def datasets(self) -> tuple[str, ...]:
        """Names of the tables that there are."""
        return tuple(self._names)

    def read(
        self, dataset: str, columns: Sequence[str] | None = None, records: NDArray[np.int64] | None = None
    ) -> pd.DataFrame:
        """Return a table, or some columns of it, of all records or of those of the parts that hold the given ones."""
        if dataset not in self._names:
            raise self._fault(dataset, "is missing")
        if dataset in _CAMPAIGN:
            return self._of_campaign(dataset, self._names[dataset][0], columns)
        layout = self._layout(dataset)
        expected, size, names = np.arange(self.run.n_record), self.run.part_records, self._names[dataset]
        if records is not None and len(records):
            numbers = np.unique(records // size)
            names = [name for index in numbers.tolist() for name in self._of_part[dataset].get(index, [])]
            expected = np.concatenate([expected[index * size : (index + 1) * size] for index in numbers.tolist()])
        wanted = list(layout) if columns is None else list(columns)
        of_months = any(len(files) > 1 for files in self._of_part[dataset].values())
        read = {name: layout[name] for name in dict.fromkeys([*wanted, *(["record"] if of_months else [])])}
        table = read_table(self.folder, names, read) if names else pd.DataFrame(columns=list(read))
        if of_months and not table["record"].is_monotonic_increasing:
            # a part of two turbines may begin with a later month than it ends with; its files are in the months' order
            table = table.sort_values("record", kind="stable", ignore_index=True)
        self._check_rows(dataset, table, expected)
        return table if list(table.columns) == wanted else table[wanted]

    def pieces(
        self, dataset: str, columns: Sequence[str], records: NDArray[np.int64] | None = None
    ) -> Iterator[pd.DataFrame]:
        """Give some columns of a table, of all records or of the parts that hold the given ones, piece by piece."""
        size = self.run.part_records
        wanted = np.arange(-(-self.run.n_record // size)) if records is None else np.unique(records // size)
        at_once = max(1, _AT_ONCE // size)
        for first in range(0, len(wanted), at_once):
            yield self.read(dataset, columns, wanted[first : first + at_once] * size)

    def _layout(self, dataset: str) -> dict[str, str]:
        if dataset == "posterior":
            return _POSTERIOR
        if dataset == PATTERN:
            return {**_WHERE, **dict.fromkeys(pattern_columns(len(self.beams)), "number")}
        if dataset == "draws":
            return {**_DRAW, **dict.fromkeys((*STRESSES, *self.run.nuisance_names), "amount")}
        if dataset == "predicted":
            return {**_DRAW, **dict.fromkeys((f"beam_{number}" for number in self.beams), "amount")}
        return _SUMMARY

    def _of_campaign(self, dataset: str, name: str, columns: Sequence[str] | None) -> pd.DataFrame:
        what = f"File {str(self.folder.path / name)!r}"
        try:
            table = of_csv(self.folder.read(name))
        except (pa.ArrowException, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(f"{what} cannot be used: {reason[:200]}; {ADVICE}.") from error
        check_table(pa.Table.from_pandas(table, preserve_index=False), _CAMPAIGN[dataset], what=what, advice=ADVICE)
        if dataset == TABLE:
            of_all = table.loc[table["bin"] == "all", "quantity"].tolist()
            for quantity in _WHOLE:
                if of_all.count(quantity) != 1:
                    raise InputError(
                        f"{what} cannot be used: it has {of_all.count(quantity)} rows of {quantity} over all records, "
                        f"and must have one; {ADVICE}."
                    )
        return table if columns is None else table[list(columns)]

    def _check_rows(self, dataset: str, table: pd.DataFrame, expected: NDArray[np.int64]) -> None:
        """Check that a table has the rows of the expected records, all of them, in their order, and no others."""
        if dataset in ("posterior", PATTERN):
            record = expected
        elif dataset in ("draws", "predicted"):
            n_draw = self.run.n_draw if dataset == "draws" else self.run.n_predicted
            record = np.repeat(expected[self._fitted[expected]], self.run.n_chain * n_draw)
        else:
            names = np.array([*STRESSES, *self.run.settings.fit.derived], dtype=object)
            record = np.repeat(expected, len(names))
            there = table["stress"].to_numpy(dtype=object) if "stress" in table else None
            if there is not None and (len(there) % len(names) or not np.all(there.reshape(-1, len(names)) == names)):
                raise self._fault(dataset, "has other rows than one for each record and quantity, in their order")
        if len(table) != len(record):
            raise self._fault(dataset, f"has {len(table)} rows, and must have {len(record)}")
        if "record" in table and not np.array_equal(table["record"].to_numpy(), record):
            raise self._fault(dataset, "has rows of other records than those of the fit, or in another order")

    @cached_property
    def _fitted(self) -> NDArray[np.bool_]:
        return np.asarray((self.read("posterior", ["record", "flag_bits"])["flag_bits"].to_numpy() & UNFITTED) == 0)

    def _fault(self, dataset: str, words: str) -> InputError:
        return InputError(f"Table {dataset!r} in {str(self.folder.path)!r} cannot be used: it {words}; {ADVICE}.")
