"""Results in SQLite: one row an instance, setting, method and sample size; written as they come."""

from __future__ import annotations

import json
import platform
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rootmatch._version import __version__
from rootmatch.errors import InputError
from rootmatch.research.output_files import make_folder
from rootmatch.research.paper.settings import Method, Setting
from rootmatch.solvers.base import Solution

SCHEMA_VERSION = 2
WAITS = 60.0
"""Seconds for which a run waits for another one that is writing."""

_KEY = "problem, outliers, noise, baseline, motions, residual, solver, rho, seed, samples"
"""Columns of a setting, of a method, the seed and the sample size."""
_SCHEMA = f"""
CREATE TABLE versions (id INTEGER PRIMARY KEY, text TEXT NOT NULL UNIQUE);
CREATE TABLE results (
    problem TEXT NOT NULL, outliers INTEGER NOT NULL, noise REAL NOT NULL, baseline REAL NOT NULL,
    motions INTEGER NOT NULL, residual TEXT NOT NULL, solver TEXT NOT NULL, rho REAL NOT NULL,
    seed INTEGER NOT NULL, samples INTEGER NOT NULL,
    accuracy REAL NOT NULL, score REAL NOT NULL, hyperedges INTEGER NOT NULL,
    iterations INTEGER NOT NULL, converged INTEGER NOT NULL, version INTEGER NOT NULL REFERENCES versions,
    PRIMARY KEY ({_KEY})) WITHOUT ROWID;
CREATE TABLE work (seconds REAL NOT NULL, finished TEXT DEFAULT CURRENT_TIMESTAMP);
CREATE VIEW rows AS
    SELECT {_KEY}, accuracy, score, hyperedges, iterations, converged, text AS versions
    FROM results JOIN versions ON versions.id = version;
"""


@dataclass(frozen=True)
class Row:
    """One result."""

    setting: Setting
    method: Method
    seed: int
    """Of the scene; the stream of hyper-edges and the solver have the same one."""
    samples: int
    """Hyper-edges drawn."""
    accuracy: float
    """Right matches over the number of points, 0 to 1."""
    score: float
    """Objective that the solver reached."""
    hyperedges: int
    """Different hyper-edges of weight above 10⁻¹² among those drawn."""
    iterations: int
    converged: bool
    """How the solver went."""

    @classmethod
    def of(cls, key: tuple[Setting, Method, int, int], accuracy: float, found: Solution, hyperedges: int) -> Row:
        """The row of a setting, method, seed and sample size, by a solver's solution."""
        return cls(*key, accuracy, float(found.score), hyperedges, *(found.iterations, found.converged))


def versions_in_use() -> str:
    """Versions and kind of processor, which may change a result, as JSON text."""
    names = {name: version(name) for name in ("numpy", "scipy", "numba")}
    return json.dumps(
        {"rootmatch": __version__, "python": platform.python_version(), **names, "machine": platform.machine()}
    )


class Store:
    """The results of a sweep in one SQLite file, which any number of runs may extend.

    Write-ahead logging and one transaction for each batch of rows: whatever stops the process, the file holds whole
    batches only.

    Parameters
    ----------
    path : Path
        Made, with its folder, when absent.

    Raises
    ------
    InputError
        If the file is no such store, damaged, locked, or one of another layout; later, where it cannot be written any
        more, as on a full disk. What was written before is kept.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        make_folder(path.parent, "*.sqlite")
        # Transactions are begun and ended here by hand, not by the module.
        with self._explain_errors():
            self._connection = sqlite3.connect(path, timeout=WAITS, isolation_level=None)
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        """Lay out a new file, or make sure that an old one is whole and of this layout."""
        with self._explain_errors():
            # before anything is written: a database of somebody else is left as it is
            tables = self._connection.execute("SELECT 1 FROM sqlite_master").fetchone()
            (found,) = self._connection.execute("PRAGMA user_version").fetchone()
            if found == 0 and tables:
                raise InputError(f"{self.path}: not a store of results, but another database; name another folder")
            if found not in (0, SCHEMA_VERSION):
                raise InputError(
                    f"{self.path}: layout {found}, expected {SCHEMA_VERSION}; name another output folder, or go on "
                    "with the version of rootmatch that made it"
                )
            for (line,) in self._connection.execute("PRAGMA quick_check(1)"):
                if line != "ok":
                    raise sqlite3.DatabaseError(str(line))
            self._connection.execute("PRAGMA journal_mode=WAL")
            self._connection.execute("PRAGMA synchronous=NORMAL")
            with self._transaction():
                # another run may have laid it out in the meantime
                (found,) = self._connection.execute("PRAGMA user_version").fetchone()
                if found == 0:
                    for statement in _SCHEMA.split(";\n"):
                        self._connection.execute(statement)
                    self._connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._explain_errors():
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:  # a full disk may have ended it
                    self._connection.execute("ROLLBACK")
                raise

    @contextmanager
    def _explain_errors(self) -> Iterator[None]:
        """Errors of SQLite as one line that says what to do."""
        try:
            yield
        except sqlite3.OperationalError as error:
            text = str(error)
            if "locked" in text:
                text = f"another program has held it for {WAITS:g} s; end that one"
            elif "full" in text or "disk I/O" in text:
                text = f"{text}; free some space; finished work is kept and the same command continues"
            else:
                text = f"{text}; check its permissions, or name another output folder"
            raise InputError(f"{self.path}: cannot be used: {text}") from None
        except sqlite3.DatabaseError as error:
            raise InputError(
                f"{self.path}: damaged, or not a store of results ({error}); move it away, or name another folder"
            ) from None

    def _fetch(self, query: str, values: tuple[object, ...] = ()) -> list[Any]:
        """The lines of a query."""
        with self._explain_errors():
            return self._connection.execute(query, values).fetchall()

    def add(self, rows: Iterable[Row], versions: str, seconds: float = 0.0) -> None:
        """Write rows in one transaction; those that are there already stay as they are.

        ``seconds`` is the time that it took to work them out; it is kept apart, as it differs from run to run.
        """
        with self._transaction():
            self._connection.execute("INSERT OR IGNORE INTO versions (text) VALUES (?)", (versions,))
            self._connection.executemany(
                f"INSERT OR IGNORE INTO results VALUES ({'?, ' * 15} (SELECT id FROM versions WHERE text = ?))",
                (
                    (*astuple(row.setting), *astuple(row.method), row.seed, row.samples, row.accuracy, row.score,
                     row.hyperedges, row.iterations, int(row.converged), versions)
                    for row in rows
                ),
            )  # fmt: skip
            self._connection.execute("INSERT INTO work (seconds) VALUES (?)", (seconds,))

    def done(self) -> dict[tuple[Setting, Method, int], set[int]]:
        """The sample sizes that are there, for each setting, method and seed."""
        there: dict[tuple[Setting, Method, int], set[int]] = {}
        for *key, seed, samples in self._fetch(f"SELECT {_KEY} FROM results"):
            there.setdefault((Setting(*key[:5]), Method(*key[5:]), seed), set()).add(samples)
        return there

    def rows(self) -> list[tuple[object, ...]]:
        """All rows of the view ``rows``, in an order that does not depend on when they were written."""
        return self._fetch(f"SELECT * FROM rows ORDER BY {_KEY}")

    def accuracies(self, setting: Setting, method: Method, seeds: range) -> dict[int, dict[int, float]]:
        """Accuracy by sample size and seed."""
        found: dict[int, dict[int, float]] = {}
        query = """
            SELECT samples, seed, accuracy FROM results
            WHERE problem = ? AND outliers = ? AND noise = ? AND baseline = ? AND motions = ?
              AND residual = ? AND solver = ? AND rho = ? AND seed >= ? AND seed < ? ORDER BY samples, seed"""
        values = (*astuple(setting), *astuple(method), seeds.start, seeds.stop)
        for samples, seed, accuracy in self._fetch(query, values):
            found.setdefault(samples, {})[seed] = accuracy
        return found

    def versions(self) -> list[str]:
        """The versions under which the rows were worked out."""
        return [text for (text,) in self._fetch("SELECT text FROM versions ORDER BY id")]

    def seconds(self) -> float:
        """Processor time spent on all the rows, over all runs."""
        ((total,),) = self._fetch("SELECT COALESCE(SUM(seconds), 0) FROM work")
        return float(total)
