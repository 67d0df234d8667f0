"""Put measured figures into the pages, so that each of them is written down once.

    python docs/make_tables.py           # write the tables anew
    python docs/make_tables.py --check   # exit with 1 if one of them is not what the files say

A table stands between ``<!-- table: NAME -->`` and ``<!-- end -->``. Its figures are in ``benchmarks/results/NAME.csv``
or, for the two tables of recorded data, in ``benchmarks/real/leaderboard.json``.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/benchmarks.md", "docs/real-targets.md")
RESULTS = ROOT / "benchmarks" / "results"
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


def filled(text: str) -> str:
    """A page with its tables."""
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
    print(
        *([f"{page} has other figures than the files" if check else page for page in stale] or ["nothing to do"]),
        sep="\n",
    )
    sys.exit(bool(check and stale))


if __name__ == "__main__":
    main()
