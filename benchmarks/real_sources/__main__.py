"""Make a data set of the benchmark: ``python -m real_sources DATA_SET SNAPSHOT OUTPUT``, in the folder `benchmarks`."""

from __future__ import annotations

import sys
from pathlib import Path

from real_sources import SOURCES, convert
from rootmatch.errors import InputError


def main(arguments: list[str]) -> int:
    """Convert one snapshot; 2 where that cannot be done."""
    if len(arguments) != 3:
        print(f"{__doc__}\nData sets: {', '.join(SOURCES)}", file=sys.stderr)
        return 2
    try:
        print(convert(arguments[0], Path(arguments[1]), Path(arguments[2])))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
