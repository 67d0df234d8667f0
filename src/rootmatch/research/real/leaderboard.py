"""Rows of all methods, kept as they come, and the table made of them."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.errors import InputError
from rootmatch.io.inputs import read_bytes
from rootmatch.io.outputs import write_text_atomically
from rootmatch.research.output_files import markdown_table
from rootmatch.research.real.scenes import protocols

ROWS, TABLE, PAGE = "rows", "leaderboard.json", "leaderboard.md"
Fields = dict[str, type | tuple[type, ...]]
FIELDS: Fields = {
    **dict.fromkeys(("method", "scene", "protocol"), str),
    **dict.fromkeys(("right", "wrong", "visible"), int),
    **dict.fromkeys(("full", "claimed", "misled"), bool),
    "seconds": (int, float),
    "error": (str, type(None)),
}
"""What the table reads of a row."""


def rows_file(folder: Path, method: str) -> Path:
    """File of a method's rows, one JSON object per line. Each command has a file of its own."""
    name = re.sub(r"[^\w.-]+", "-", method, flags=re.ASCII).strip("-.")[:80]
    if name != method:
        name += f"-{hashlib.sha256(method.encode(errors='surrogateescape')).hexdigest()[:8]}"
    return folder / ROWS / f"{name}.jsonl"


def read_rows(path: Path, fields: Fields = FIELDS) -> list[dict[str, Any]]:
    """Rows of a file, each with these fields at least; a last line that was cut off is left out."""
    if not path.is_file():
        return []
    rows = []
    for number, line in enumerate(read_bytes(path).split(b"\n")[:-1], start=1):
        try:
            row = json.loads(line)
            whole = all(isinstance(row[name], kinds) for name, kinds in fields.items())
        except (ValueError, TypeError, LookupError, RecursionError):
            whole = False
        if not whole:
            raise InputError(f"{path}, line {number}: damaged; remove the file to measure again")
        rows.append(row)
    return rows


def append_row(path: Path, row: dict[str, Any]) -> None:
    """Add a row, whole: what an earlier run left of its last line is removed first."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a+b") as file:
            file.seek(0)
            content = file.read()
            file.truncate(content.rfind(b"\n") + 1)
            file.write(json.dumps(row, allow_nan=False).encode() + b"\n")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); free some space and run the same command again"
        ) from None


def write_leaderboard(folder: Path) -> list[dict[str, Any]]:
    """Table and page from all rows in the folder; returns the table."""
    table = [
        entry
        for path in sorted((folder / ROWS).glob("*.jsonl"))
        if (rows := read_rows(path))
        for entry in summarise(rows)
    ]
    write_text_atomically(folder / TABLE, json.dumps(table, indent=1, allow_nan=False) + "\n")
    write_text_atomically(folder / PAGE, leaderboard_page(table))
    return table


def summarise(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One entry a protocol of one method's rows."""
    entries = []
    for protocol in protocols():
        mine = [row for row in rows if row["protocol"] == protocol.name]
        if not mine:
            continue
        seconds = [row["seconds"] for row in mine]
        found = sum(row["right"] + row["wrong"] for row in mine)
        entries.append(
            {
                "method": mine[0]["method"],
                "protocol": protocol.name,
                "scenes": len(mine),
                "full": sum(row["full"] for row in mine),
                "recall": sum(row["right"] for row in mine) / max(sum(row["visible"] for row in mine), 1),
                "precision": sum(row["right"] for row in mine) / found if found else None,
                "claimed": sum(row["claimed"] for row in mine),
                "claimed_and_wrong": sum(row["claimed"] and row["misled"] for row in mine),
                "no_reply": sum(row["error"] is not None for row in mine),
                "median_seconds": float(np.median(seconds)),
                "most_seconds": float(np.max(seconds)),
            }
        )
    return entries


def leaderboard_page(table: Iterable[dict[str, Any]]) -> str:
    """The table for people."""
    figures = ("full", "recall", "precision", "claimed", "claimed and wrong", "no reply", "median, worst s")
    rows, table = [], list(table)
    for protocol in protocols():
        for entry in (entry for entry in table if entry["protocol"] == protocol.name):
            precision = "–" if entry["precision"] is None else f"{entry['precision']:.3f}"
            rows.append((
                protocol.name, f"`{entry['method']}`", f"{entry['full']} of {entry['scenes']}",
                f"{entry['recall']:.3f}", precision,
                str(entry["claimed"]), str(entry["claimed_and_wrong"]), str(entry["no_reply"]),
                f"{entry['median_seconds']:.3g}, {entry['most_seconds']:.3g}",
            ))  # fmt: skip
    return "\n".join(markdown_table(("scenes", "method", *figures), rows))
