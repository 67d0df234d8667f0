"""The yardstick as a method of `rootmatch benchmark real`: brute-force hypothesise-and-verify, from a file of its own.

    rootmatch benchmark real --data FOLDER --output DIR --method "python benchmarks/real_yardstick.py PEERS"

PEERS is the folder of ransac.py. It knows no normals, no distortion, no noise of a vertical and no two views: normals
are not used, detections are undistorted by OpenCV, the vertical is taken for exact, and scenes of two views get no
reply. It has ten seconds of processor time a motion, whatever else the machine does.
"""

from __future__ import annotations

import json
import sys
import time
from types import SimpleNamespace
from typing import Any

import numpy as np

MINIMUM = 4
"""Points that it needs."""
JITTER = 1e-6
"""Of the points' extent, far below any noise: three points of a lattice in a row make its matrices singular."""


def reply(request: dict[str, Any], ransac: Any) -> dict[str, Any]:
    """The assignment with the most inliers, of one motion and then of another among what is left."""
    if request["problem"] == "3p1" or "candidates" in request:
        return {"error": "the yardstick has no two views and takes no candidates"}
    camera = request["camera"]
    K = np.array([[camera["fx"], 0.0, camera["cx"]], [0.0, camera["fy"], camera["cy"]], [0.0, 0.0, 1.0]])
    source, target = np.array(request["source"]), np.array(request["target"])
    source = source + JITTER * source.std() * np.random.default_rng(0).normal(size=source.shape)
    if "dist" in camera:
        import cv2

        target = cv2.undistortPoints(target[:, None], K, np.array(camera["dist"]), P=K)[:, 0]
    known = {"tol_px": 3.5 * request["noise"], "max_seconds": 10.0, "seed": 0}
    if request["problem"] == "up2p":
        known |= {"problem": "up2p", "up_cam": request["vertical_camera"], "up_world": request["vertical_world"]}
    started = time.process_time()
    found = np.full(len(source), -1)
    for _ in range(request.get("motions", 1)):
        rest, free = np.flatnonzero(found < 0), np.setdiff1d(np.arange(len(target)), found)
        if min(len(rest), len(free)) < MINIMUM:
            break
        more = np.asarray(ransac.ransac_match(source[rest], target[free], K, **known)[0])
        found[rest] = np.where(more >= 0, free[more], -1)
    return {"assignment": np.asarray(found).tolist(), "seconds": time.process_time() - started}


def main() -> None:
    """Answer a line of JSON by a line of JSON."""
    sys.path.insert(0, sys.argv[1])
    import ransac

    ransac.time = SimpleNamespace(perf_counter=time.process_time)  # by which it keeps its limit
    for line in sys.stdin:
        print(json.dumps(reply(json.loads(line), ransac)), flush=True)


if __name__ == "__main__":
    main()
