"""Match the board's corners to the photograph's from geometry alone and compare with the ground truth.

Runs the command line tool on the files next to this script, as a user would, and reads what it wrote.
"""

import argparse
import csv
import os
import shlex
import subprocess
import sys
from pathlib import Path

HERE = Path(os.path.relpath(Path(__file__).resolve().parent))  # short when printed
NOISE = 0.3  # pixels; corner detection alone has about 0.15, and lens and board are not perfect
UNMATCHED = -1


def read_pairs(path: Path) -> dict[int, int]:
    """Target of each source of a CSV file with the columns ``source`` and ``target``."""
    with path.open(newline="", encoding="utf-8") as lines:
        return {int(row["source"]): int(row["target"]) for row in csv.DictReader(lines)}


def arguments_for(output: Path) -> list[str]:
    """Arguments of ``rootmatch`` that match this folder's files."""
    files = [HERE / "model.csv", HERE / "image.csv"]
    known = ["--problem", "p3p", "--camera", HERE / "camera.json", "--noise", NOISE, "--seed", 0]
    results = ["--output", output / "matches.csv", "--plot", output / "match.png"]
    return [str(argument) for argument in ("match", *files, *known, *results)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=HERE / "output", help="folder for matches.csv and match.png")
    output: Path = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    for name in ("matches.csv", "match.png"):
        (output / name).unlink(missing_ok=True)  # never judge the result of an earlier run

    arguments = arguments_for(output)
    print("$", shlex.join(["rootmatch", *arguments]), flush=True)
    print("(the first run compiles the kernels, which takes longer than the match)", flush=True)
    tool = [sys.executable, "-c", "from rootmatch.cli import main; main()"]  # with this interpreter
    # 0 is a trusted match and 1 a doubtful one, written all the same; here the ground truth decides.
    code = subprocess.run([*tool, *arguments], stdout=subprocess.DEVNULL, check=False).returncode
    if code not in (0, 1) or not (output / "matches.csv").is_file():
        print(f"rootmatch match failed with exit code {code}", file=sys.stderr)
        return 1

    found, truth = read_pairs(output / "matches.csv"), read_pairs(HERE / "truth.csv")
    print("\nsource  target  truth")
    right = 0
    for source, expected in sorted(truth.items()):
        target = found.get(source, UNMATCHED)
        right += target == expected
        verdict = "right" if target == expected else "WRONG"
        print(f"{source:6d}  {target if target != UNMATCHED else '-':>6}  {expected:5d}  {verdict}")
    print(f"\n{right} of {len(truth)} right" + (", but rootmatch itself does not trust the match" if code else ""))
    picture = output / "match.png"
    if not picture.is_file():
        print("but no picture was drawn", file=sys.stderr)
        return 1
    print(f"picture: {picture}")
    return 0 if right == len(truth) else 1


if __name__ == "__main__":
    sys.exit(main())
