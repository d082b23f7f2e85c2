"""What a fit holds, wherever it is: tables, draws, records, flags."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.columns import COVARIANCES, PAIRS
from bayes_rs.fits.flags import FLAGS, UNFITTED, flag_words
from bayes_rs.fits.read_only import read_only, read_only_dataset
from bayes_rs.fits.record_keys import RecordKey, record_number
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES

_BATCH = 128
"""Records whose draws are held at a time."""


class Tables(Protocol):
    """Where the tables of a fit are."""

    @property
    def datasets(self) -> tuple[str, ...]:
        """Names of the tables that there are."""

    def read(
        self, dataset: str, columns: Sequence[str] | None = None, records: NDArray[np.int64] | None = None
    ) -> pd.DataFrame:
        """Return a table, or some columns of it, of all records or of those in a range that holds the given ones."""

    def pieces(
        self, dataset: str, columns: Sequence[str], records: NDArray[np.int64] | None = None
    ) -> Iterator[pd.DataFrame]:
        """Give the same of a table in parts, piece by piece, so that it is never in memory as a whole."""


@dataclass(frozen=True)
class MemoryTables:
    """Tables in memory.

    Parameters
    ----------
    parts : dict
        The parts of each table, in the order of their records. They are joined when the table is first read: tables of
        draws are large, and a summary does without them.
    """

    parts: dict[str, list[pd.DataFrame]]

    @property
    def datasets(self) -> tuple[str, ...]:
        """Names of the tables that there are."""
        return tuple(self.parts)

    def read(
        self, dataset: str, columns: Sequence[str] | None = None, records: NDArray[np.int64] | None = None
    ) -> pd.DataFrame:
        """Return a table, or some columns of it; its rows are in the order of the records."""
        parts = self.parts[dataset]
        if len(parts) > 1:
            parts[:] = [pd.concat(parts, ignore_index=True)]
        table = parts[0]
        if records is not None and len(records):
            ends = np.searchsorted(table["record"].to_numpy(), [records.min(), records.max() + 1])
            table = table.iloc[ends[0] : ends[1]]
        return table if columns is None else table[list(columns)]

    def pieces(
        self, dataset: str, columns: Sequence[str], records: NDArray[np.int64] | None = None
    ) -> Iterator[pd.DataFrame]:
        """Give some columns of a table: it is in memory, and is one piece."""
        yield self.read(dataset, columns, records)

    def with_tables(self, others: Mapping[str, pd.DataFrame]) -> MemoryTables:
        """Return these tables and others, each in one part."""
        return MemoryTables({**self.parts, **{name: [table] for name, table in others.items()}})


@dataclass(frozen=True, eq=False)
class FitData:
    """What a fit holds, in memory or in a folder; `Fit` adds what is made of it.

    Parameters
    ----------
    run : mapping
        What was run, as plain values: settings, versions, scan, prior, noise, counts; the content of ``run.json``.
    scan : Scan
        The scan, with the records' beams.
    source : Tables
        Where its tables are.
    loaded : callable
        Returns the records and the draws of the prior.
    place : str
        The folder, a whole path; empty in memory.
    """

    run: Mapping[str, Any]
    scan: Scan
    source: Tables
    loaded: Any
    place: str = ""

    @cached_property
    def _records(self) -> xr.Dataset:
        records: xr.Dataset = self.loaded.records()
        return read_only_dataset(records)

    @property
    def records(self) -> xr.Dataset:
        """The records that were fitted; their arrays are read-only, and ``records.copy(deep=True)`` can be changed."""
        return self._records.copy(deep=False)

    @cached_property
    def prior_draws(self) -> FloatArray:
        """Draws of the prior, shape (n, 6), m² s⁻²; read-only."""
        return read_only(np.asarray(self.loaded.prior_draws(), dtype=np.float64))

    @property
    def settings(self) -> Mapping[str, Any]:
        """Everything that the fit depended on, section by section, as plain values."""
        settings: Mapping[str, Any] = self.run["settings"]
        return settings

    @property
    def n_record(self) -> int:
        """Number of records."""
        return int(self.run["n_record"])

    @cached_property
    def flag(self) -> NDArray[np.int64]:
        """Flags of the records, shape (n_record,): bit masks as in `FLAGS`; read-only."""
        return read_only(self.source.read("posterior", ["record", "flag_bits"])["flag_bits"].to_numpy(dtype=np.int64))

    @property
    def fitted(self) -> NDArray[np.bool_]:
        """Which records have a posterior, shape (n_record,)."""
        return np.asarray((self.flag & UNFITTED) == 0)

    @property
    def n_fitted(self) -> int:
        """Number of records that have a posterior."""
        return int(np.count_nonzero(self.fitted))

    @property
    def flags(self) -> dict[str, int]:
        """How many records have each flag."""
        return {word: int(np.count_nonzero(self.flag & bit)) for word, bit in FLAGS.items()}

    @cached_property
    def time(self) -> NDArray[np.datetime64]:
        """Starts of the records, shape (n_record,); NaT where there is no time; read-only."""
        starts = self.source.read("posterior", ["record", "time"])["time"].to_numpy()
        return read_only(starts.astype("datetime64[ns]"))

    @property
    def has_draws(self) -> bool:
        """Whether the draws were kept."""
        return "draws" in self.source.datasets

    @property
    def nuisance_names(self) -> tuple[str, ...]:
        """Names of the nuisances that were sampled."""
        names: Sequence[str] = self.run["nuisance_names"]
        return tuple(names)

    def table(self, dataset: str) -> pd.DataFrame:
        """Return a table as it was written.

        Parameters
        ----------
        dataset : str
            ``"summary"``; ``"posterior"``, a row for each record with flag, sampler, diagnostics, covariances of the
            stresses and contractions along the directions of R; or, where draws were kept, ``"draws"`` or
            ``"predicted"``.

        Returns
        -------
        table : DataFrame
            In the order of the records; a table of your own, which you may change.

        Raises
        ------
        InputError
            If there is no such table.
        """
        if dataset not in self.source.datasets:
            raise (
                self._no_draws()
                if dataset in ("draws", "predicted")
                else InputError(f"No table {dataset!r} of this fit: it has {', '.join(self.source.datasets)}.")
            )
        return self.source.read(dataset).copy()  # what is kept, or read-only, is not handed out

    def of_stresses(self, *names: str, dataset: str = "summary") -> dict[str, FloatArray]:
        """Return columns of the summary, each of shape (n_record, 6), without those of derived quantities.

        The table is read piece by piece: of a million records a column takes 48 MB.
        """
        found = {name: np.empty((self.n_record, len(STRESSES))) for name in names}
        n_row = len(STRESSES) + len(self.settings["fit"]["derived"])
        first = 0
        for piece in self.source.pieces(dataset, [*names]):
            last = first + len(piece) // n_row
            for name, values in found.items():
                # the stresses come first of each record, in the order of STRESSES
                values[first:last] = piece[name].to_numpy(dtype=np.float64).reshape(-1, n_row)[:, : len(STRESSES)]
            first = last
        return found

    def of_records(self, *names: str) -> dict[str, FloatArray]:
        """Return columns of the table ``posterior``, each of shape (n_record,), read piece by piece."""
        found = {name: np.empty(self.n_record) for name in names}
        first = 0
        for piece in self.source.pieces("posterior", [*names]):
            last = first + len(piece)
            for name, values in found.items():
                values[first:last] = piece[name].to_numpy(dtype=np.float64)
            first = last
        return found

    def covariance(self, records: NDArray[np.int64] | None = None) -> FloatArray:
        """Return the posterior covariances of the stresses.

        Parameters
        ----------
        records : ndarray of int, shape (n,), optional
            Numbers of records, rising; by default all.

        Returns
        -------
        covariance : ndarray, shape (n_record, 6, 6)
            m⁴ s⁻⁴; NaN for records that were not fitted.
        """
        number = np.arange(self.n_record) if records is None else records
        matrix = np.empty((len(number), len(STRESSES), len(STRESSES)))
        first = 0
        for piece in self.source.pieces("posterior", ["record", *COVARIANCES], records):
            rows = piece if records is None else piece[np.isin(piece["record"].to_numpy(), records)]
            last = first + len(rows)
            for name, (i, j) in zip(COVARIANCES, PAIRS, strict=True):
                matrix[first:last, i, j] = matrix[first:last, j, i] = rows[name].to_numpy()
            first = last
        return matrix

    def draws(self, record: RecordKey | None = None) -> FloatArray:
        """Return the posterior's draws of the stresses.

        Parameters
        ----------
        record : int, str, datetime, Timestamp or datetime64, optional
            Number of a record, or its start (UTC; a text is an ISO time); by default all records.

        Returns
        -------
        draws : ndarray, shape (n_record, n_chain, n_draw, 6), or (n_chain, n_draw, 6) of one record
            m² s⁻²; NaN for records that were not fitted.

        Raises
        ------
        InputError
            If the draws were not kept, or there is no such record, or it was not fitted.
        """
        if record is None:
            return self._draws_of(np.arange(self.n_record), "draws", STRESSES)
        return np.asarray(self._draws_of(np.array([self.find_record(record)]), "draws", STRESSES)[0])

    def batches(self) -> Iterator[tuple[NDArray[np.int64], FloatArray]]:
        """Give the draws of all fitted records some records at a time.

        Yields
        ------
        record : ndarray of int, shape (n,)
            Numbers of the records.
        draws : ndarray, shape (n, n_chain, n_draw, 6)
            m² s⁻².

        Raises
        ------
        InputError
            If the draws were not kept.
        """
        fitted = self.fitted
        for first in range(0, self.n_record, _BATCH):
            rows = np.arange(first, min(first + _BATCH, self.n_record))
            rows = rows[fitted[rows]]
            if len(rows):
                yield rows, self._draws_of(rows, "draws", STRESSES)

    def nuisance_draws(self, name: str) -> FloatArray:
        """Return the draws of a nuisance that was sampled.

        Parameters
        ----------
        name : str
            One of `nuisance_names`.

        Returns
        -------
        draws : ndarray, shape (n_record, n_chain, n_draw)
            In the units of the group ``posterior``.

        Raises
        ------
        InputError
            If it was not sampled, or the draws were not kept.
        """
        if name not in self.nuisance_names:
            known = ", ".join(self.nuisance_names) or "none"
            raise InputError(f"No nuisance {name!r} was sampled: those of this fit are {known}.")
        return self._draws_of(np.arange(self.n_record), "draws", (name,))[..., 0]

    def predicted_draws(self) -> FloatArray:
        """Return radial variances that the posterior predicts.

        Returns
        -------
        draws : ndarray, shape (n_record, n_chain, n_predicted, n_beam)
            m² s⁻²; NaN for beams that a record does not use.

        Raises
        ------
        InputError
            If the draws were not kept.
        """
        beams = [f"beam_{number}" for number in self.scan.beam.tolist()]
        return self._draws_of(np.arange(self.n_record), "predicted", beams)

    def find_record(self, record: RecordKey) -> int:
        """Return the number of a fitted record.

        Parameters
        ----------
        record : int, str, datetime, Timestamp or datetime64
            Number of the record, or its start (UTC; a text is an ISO time).

        Returns
        -------
        number : int
            Its place among the records.

        Raises
        ------
        InputError
            If there is no such record, or it was not fitted.
        """
        index = record_number(record, self.n_record, lambda: self.time)
        if not self.fitted[index]:
            raise InputError(
                f"Record {index} was not fitted ({flag_words(int(self.flag[index]))}): choose another one."
            )
        return index

    def _draws_of(self, record: NDArray[np.int64], dataset: str, names: Sequence[str]) -> FloatArray:
        """Return draws (len(record), n_chain, n_draw, len(names)) of a table with one row a draw."""
        if dataset not in self.source.datasets:
            raise self._no_draws()
        table = self.source.read(dataset, ["record", *names], record)
        n_chain, n_draw = int(self.run["n_chain"]), int(self.run["n_draw" if dataset == "draws" else "n_predicted"])
        found = np.full((len(record), n_chain, n_draw, len(names)), np.nan)
        number = table["record"].to_numpy()
        there = np.unique(number)  # the draws of a record stand together, in the order of the records
        values = np.stack([table[name].to_numpy(dtype=np.float64) for name in names], axis=-1)
        values = values.reshape(len(there), n_chain, n_draw, len(names))
        _, of_found, of_values = np.intersect1d(record, there, assume_unique=True, return_indices=True)
        found[of_found] = values[of_values]
        return found

    def _no_draws(self) -> InputError:
        where = f" in {self.place!r}" if self.place else ""
        return InputError(
            f"The fit{where} kept no draws, which this needs: fit again with draws='float32' (--draws float32)."
        )
