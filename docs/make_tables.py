"""Put measured figures into the pages, so that each of them is written down once.

    python docs/make_tables.py           # write the tables anew
    python docs/make_tables.py --check   # exit with 1 if one of them is not what the files say

A table stands between ``<!-- table: NAME -->`` and ``<!-- end -->``. Its figures are in ``benchmarks/results/NAME.csv``
or, for the two tables of recorded data, in ``benchmarks/real/leaderboard.json``. Those of the paper's experiments stand
between ``<!-- NAME -->`` and ``<!-- end of NAME -->`` and are taken from ``docs/reproduction/claims.md``.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/benchmarks.md", "docs/real-targets.md", "docs/reproduction.md")
RESULTS = ROOT / "benchmarks" / "results"
CLAIMS = ROOT / "docs" / "reproduction" / "claims.md"
JUDGED = re.compile(r"(<!-- (rho|solvers|verdicts) -->\n).*?(?=<!-- end of \2 -->)", re.DOTALL)
TABLE = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(?=<!-- end -->)", re.DOTALL)

METHODS = {
    "rootmatch": "rootmatch",
    "rootmatch-paper": "paper's preset",
    "python benchmarks/real_yardstick.py peers": "brute force",
}
"""Methods of the leaderboard, as the pages call them."""
SHOWN = {
    "headset-normals": "headset, 7 to 12 of 32 LEDs visible, normals known",
    "headset": "the same without normals",
    "dots": "20 dots among 40 false detections",
    "targets": "15 to 131 of 157 targets visible, lens distortion",
    "film": "14 to 19 of 26 film tracks visible, no clutter",
}
"""Scenes that the README shows."""


def table(header: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def from_csv(name: str) -> str:
    """What a file of results says."""
    with (RESULTS / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return table(header, rows)


def seconds(value: float | None) -> str:
    """A time to two digits."""
    if value is None:
        return "–"
    return f"{1e3 * value:.2g} ms" if value < 0.0995 else f"{value:.2g} s"


def leaderboard() -> list[dict]:
    """Rows of `rootmatch benchmark real`."""
    return json.loads((ROOT / "benchmarks" / "real" / "leaderboard.json").read_text(encoding="utf-8"))


def real() -> str:
    """Every row of the leaderboard."""
    rows = []
    for row in sorted(leaderboard(), key=lambda row: list(METHODS).index(row["method"])):
        precision = "–" if row["precision"] is None else f"{row['precision']:.3f}"
        counts = [f"{row['full']}/{row['scenes']}", f"{row['recall']:.3f}", precision]
        counts += [str(row[key]) for key in ("claimed", "claimed_and_wrong", "no_reply")]
        times = [seconds(row["median_seconds"]), seconds(row["most_seconds"])]
        rows.append([f"`{row['protocol']}`", METHODS[row["method"]], *counts, *times])
    order = list(dict.fromkeys(row["protocol"] for row in leaderboard()))
    rows.sort(key=lambda row: order.index(row[0].strip("`")))
    header = ["scenes", "method", "full", "recall", "precision", "claimed", "claimed and wrong", "no reply"]
    return table([*header, "median", "worst"], rows)


def versus() -> str:
    """Rows of the leaderboard that the README shows: ours beside brute force."""
    found = {(row["protocol"], METHODS[row["method"]]): row for row in leaderboard()}
    rows = []
    for protocol, words in SHOWN.items():
        ours, theirs = found[protocol, "rootmatch"], found[protocol, "brute force"]
        counts = [f"{one['full']} of {one['scenes']}" for one in (ours, theirs)]
        rows.append([words, *counts, *(seconds(one["median_seconds"]) for one in (ours, theirs))])
    header = ["recorded data", "rootmatch: right", "brute force: right", "rootmatch: time", "brute force: time"]
    return table(header, rows)


def in_a_word(verdict: str) -> str:
    """A verdict without the cases that it names."""
    words = {"holds only": "in part", "holds": "holds", "does not hold": "no", "undecidable": "undecidable", "": ""}
    return next(short for long, short in words.items() if verdict.startswith(long))


def claims(name: str) -> str:
    """What the judged claims say: the ρ that meet everything, how many claims hold, or each of them in a word."""
    lines = CLAIMS.read_text(encoding="utf-8").splitlines()
    if name == "rho":
        return "\n".join(line.replace(", all of these", "") for line in lines if ", all of these: " in line) + "\n"
    start = next(
        k for k, line in enumerate(lines) if line.startswith("| solver | ρ |" if name == "solvers" else "|  | ")
    )
    rows = [line[2:-2].split(" | ") for line in lines[start : lines.index("", start)]]
    if name == "solvers":
        return table(rows[0], rows[2:])
    ways = [
        way.replace("solver of the text, one ρ", "text").replace("published solver, one ρ", "published")
        for way in rows[0][2:-1]
    ]
    cut = [[*row[:2], *map(in_a_word, (cell.strip() for cell in row[2:6]))] for row in rows[2:]]
    return table(["", "claim", *ways], cut)


def filled(text: str) -> str:
    """A page with its tables."""
    text = JUDGED.sub(lambda found: found[1] + "\n" + claims(found[2]) + "\n", text)
    own = {"real": real, "versus": versus}
    return TABLE.sub(lambda found: found[1] + "\n" + own.get(found[2], lambda: from_csv(found[2]))() + "\n", text)


def main() -> None:
    """Write the tables, or say which are stale."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    stale = []
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        if filled(text) != text:
            stale.append(page)
            if not check:
                (ROOT / page).write_text(filled(text), encoding="utf-8")
    for page in stale:
        print(f"{page}: {'other figures than in the files' if check else 'written'}")
    sys.exit(bool(check and stale))


if __name__ == "__main__":
    main()
