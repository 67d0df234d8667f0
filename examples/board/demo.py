"""Match the board's corners to the photograph's from geometry alone and hold the answer against the truth.

Runs the command line tool on the files beside this script, as a user would, and reads what it wrote.
"""

import argparse
import csv
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(os.path.relpath(Path(__file__).resolve().parent))  # short in what is printed
NOISE = 0.3  # pixels; the corners' own is about 0.15, and lens and board are not perfect
UNMATCHED = -1


def read_pairs(path: Path) -> dict[int, int]:
    """Target of each source of a CSV file with the columns ``source`` and ``target``."""
    with path.open(newline="", encoding="utf-8") as lines:
        return {int(row["source"]): int(row["target"]) for row in csv.DictReader(lines)}


def command_for(output: Path) -> list[str]:
    """The call of ``rootmatch match`` on this folder's files, with the script that stands beside this Python."""
    program = shutil.which("rootmatch", path=str(Path(sys.executable).parent)) or shutil.which("rootmatch")
    if program is None:
        raise SystemExit("rootmatch is not installed for this Python; run `make demo`, or `pip install -e .` first")
    files = [str(HERE / "model.csv"), str(HERE / "image.csv")]
    options = ["--problem", "p3p", "--camera", str(HERE / "camera.json"), "--noise", str(NOISE), "--seed", "0"]
    return [
        program,
        "match",
        *files,
        *options,
        "--output",
        str(output / "matches.csv"),
        "--plot",
        str(output / "match.png"),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=HERE / "output", help="folder for matches.csv and match.png")
    output: Path = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    for name in ("matches.csv", "match.png"):
        (output / name).unlink(missing_ok=True)  # never judge an earlier run's answer

    command = command_for(output)
    print("$", shlex.join(["rootmatch", *command[1:]]), flush=True)
    # 0 is a match to trust and 1 a doubtful one, written all the same; here the truth decides.
    code = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode
    if code not in (0, 1) or not (output / "matches.csv").is_file():
        print(f"rootmatch match ended with exit code {code}", file=sys.stderr)
        return 1

    found, truth = read_pairs(output / "matches.csv"), read_pairs(HERE / "truth.csv")
    print("\nsource  target  truth")
    right = 0
    for source, wanted in sorted(truth.items()):
        target = found.get(source, UNMATCHED)
        right += target == wanted
        verdict = "right" if target == wanted else "WRONG"
        print(f"{source:6d}  {target if target != UNMATCHED else '-':>6}  {wanted:5d}  {verdict}")
    print(f"\n{right} of {len(truth)} right" + (", but rootmatch itself does not trust the answer" if code else ""))
    picture = output / "match.png"
    if not picture.is_file():
        print("but no picture was drawn", file=sys.stderr)
        return 1
    print(f"picture: {picture}")
    return 0 if right == len(truth) else 1


if __name__ == "__main__":
    sys.exit(main())
