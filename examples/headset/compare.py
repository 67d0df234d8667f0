"""Compare the poses found with the simulated ones: ``python compare.py truth.csv poses.csv``."""

import csv
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

PLACE, TURN = ("tx", "ty", "tz"), ("qx", "qy", "qz", "qw")
truth, found = (list(csv.DictReader(Path(name).read_text().splitlines())) for name in sys.argv[1:])
known = {(row["frame"], row["body"]): row for row in truth}
for body in dict.fromkeys(row["body"] for row in truth):
    mine = [row for row in found if row["body"] == body]
    matched = [row for row in mine if row["status"] == "matched"]
    place, turn = [], []
    for row in matched:
        true = known[row["frame"], body]
        place.append(np.linalg.norm([float(row[name]) - float(true[name]) for name in PLACE]))
        a, b = (Rotation.from_quat([float(one[name]) for name in TURN]) for one in (row, true))
        turn.append(np.degrees((a * b.inv()).magnitude()))
    print(
        f"{body}: {len(matched)} of {len(mine)} frames matched; median error {1e3 * np.median(place):.2f} mm and "
        f"{np.median(turn):.2f}°, worst {1e3 * max(place):.1f} mm and {max(turn):.1f}°"
    )
