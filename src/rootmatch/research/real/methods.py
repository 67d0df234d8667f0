"""Methods as programs: a request per line in, a reply per line out, both JSON.

    python -m rootmatch.research.real.methods rootmatch
    python -m rootmatch.research.real.methods rootmatch-paper

A reply holds ``assignment`` (n,) with −1 for unmatched and, where the method knows them, ``matched`` (whether it
vouches for the assignment) and ``seconds`` (of processor time, without start-up and compiling).
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

METHODS = ("rootmatch", "rootmatch-paper")


def reply(request: dict[str, Any], method: str) -> dict[str, Any]:
    """The library's answer, with its defaults or with the paper's preset."""
    from rootmatch.api import match
    from rootmatch.errors import InputError

    known: dict[str, Any] = {"noise": request["noise"]}
    source, target = np.array(request["source"]), np.array(request["target"])
    for name in ("normals", "motions"):
        if name in request:
            known[name] = request[name]
    if "candidates" in request:
        mask = np.zeros((len(source), len(target)), np.bool_)
        mask[tuple(np.array(request["candidates"]).T)] = True
        known["candidates"] = mask
    if method == "rootmatch-paper":
        known["preset"] = "paper"
    started = time.process_time()
    try:
        found = match(source, target, make_problem(request), **known)
    except InputError as error:
        return {"error": str(error)}
    return {
        "assignment": found.assignment.tolist(),
        "matched": bool(found.status),
        "seconds": time.process_time() - started,
    }


def make_problem(request: dict[str, Any]) -> Any:
    """The problem that a request describes."""
    from rootmatch.problems.p3p import P3P
    from rootmatch.problems.three_plus_one import ThreePlusOne
    from rootmatch.problems.up2p import UP2P

    camera = _camera(request["camera"])
    if request["problem"] == "p3p":
        return P3P(camera)
    if request["problem"] == "up2p":
        names = "vertical_camera", "vertical_world", "vertical_noise"
        return UP2P(camera, **{name: request[name] for name in names})
    names = "axis", "axis2", "axis_noise"
    return ThreePlusOne(camera, _camera(request["camera2"]), **{name: request[name] for name in names})


def _camera(known: dict[str, Any]) -> Any:
    from rootmatch.cameras.pinhole import Camera

    plain = Camera(*(known[name] for name in ("fx", "fy", "cx", "cy")))
    return Camera.from_opencv(plain.matrix, known["dist"]) if "dist" in known else plain


def main(method: str) -> None:
    """Answer requests from standard input until it ends."""
    for line in sys.stdin:
        print(json.dumps(reply(json.loads(line), method)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
