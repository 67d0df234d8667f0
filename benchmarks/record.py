"""Record the results of matching on fixed scenes and compare two recordings, to check that a refactoring loses nothing.

    python benchmarks/record.py record before.json     # at the old revision
    python benchmarks/record.py record after.json      # at the new one
    python benchmarks/record.py compare before.json after.json

300 matches: every problem, exhaustive and guided, several motions, normals, candidates, per-point and estimated noise,
the paper's preset, `Matcher`. The scenes are made here, from NumPy alone, so that both revisions see the same bits. The
comparison asks for equal assignments and statuses and for scores equal to 1e-12; it prints every case that differs and
ends with 1 when one does.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import rootmatch as rm

CAMERA = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
TOLERANCE = 1e-12
Case = tuple[str, Any]


def rotation(rng: np.random.Generator, upright: bool = False) -> np.ndarray:
    """A random rotation, about y if upright."""
    if upright:
        c, s = np.cos(angle := rng.uniform(-np.pi, np.pi)), np.sin(angle)
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    q = rng.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def absolute(seed: int, n: int, clutter: int, sigma: float, upright: bool = False, motions: int = 1) -> dict[str, Any]:
    """Points in a cube and their image among clutter."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2.0, 2.0, (n, 3))
    pixels = np.empty((n, 2))
    for members in np.array_split(np.arange(n), motions):
        seen = points[members] @ rotation(rng, upright).T + np.array([*rng.uniform(-1, 1, 2), rng.uniform(10, 14)])
        pixels[members] = CAMERA.project(seen)
    pixels += sigma * rng.normal(size=pixels.shape)
    pixels = np.vstack([pixels, rng.uniform((0, 0), (640, 480), (clutter, 2))])
    return {"source": points, "target": pixels[rng.permutation(len(pixels))], "rng": rng}


def views(seed: int, n: int, clutter: int, sigma: float, baseline: float, planar: bool = False) -> dict[str, Any]:
    """Two images of points, the second rotated about y."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-3, -2, 8), (3, 2, 14), (n, 3))
    c, s = np.cos(angle := rng.uniform(-0.4, 0.4)), np.sin(angle)
    move = rng.normal(size=3) * (1, 0 if planar else 1, 1)
    moved = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + baseline * move / np.linalg.norm(move)
    first = CAMERA.project(points) + sigma * rng.normal(size=(n, 2))
    second = CAMERA.project(moved) + sigma * rng.normal(size=(n, 2))
    second = np.vstack([second, rng.uniform((0, 0), (640, 480), (clutter, 2))])
    return {"source": first, "target": second[rng.permutation(len(second))], "rng": rng}


def flat(seed: int, n: int, clutter: int, sigma: float, dimension: int, scale: float) -> dict[str, Any]:
    """Two point sets in one space, the second moved and scaled."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(n, dimension))
    turn = rotation(rng)
    if dimension == 2:
        c, s = np.cos(angle := rng.uniform(-np.pi, np.pi)), np.sin(angle)
        turn = np.array([[c, -s], [s, c]])
    other = scale * points @ turn.T + rng.normal(size=dimension) + sigma * rng.normal(size=points.shape)
    other = np.vstack([other, scale * rng.normal(size=(clutter, dimension))])
    return {"source": points, "target": other[rng.permutation(len(other))], "rng": rng}


def derived() -> rm.Problem:
    """Planar motion derived again from its equation."""
    import sympy as sp

    x, tx, tz = sp.symbols("x tx tz")
    turn = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])
    move = sp.Matrix([tx, 0, tz])
    try:
        from rootmatch import Bearings
    except ImportError:
        from rootmatch.derive import Bearings
    return rm.derive(
        "floor", each=lambda p, q: q.dot(move.cross(turn * p)), minimal=2, shared=x, eliminate=[tx, tz],
        source=Bearings(CAMERA), target=Bearings(CAMERA),
    )  # fmt: skip


def described(match: rm.Match) -> dict[str, Any]:
    """The parts of a match that are compared."""
    return {
        "assignment": match.assignment.tolist(),
        "status": match.status.name,
        "score": match.score,
        "motions": match.motion_labels.tolist(),
        "alternatives": [[other.tolist(), float(score)] for other, score in match.alternatives],
        "hyperedges": int(match.evaluated),
        "entries": len(match.tensor.weights),
        "noise": float(np.mean(match.noise)),
    }


def cases() -> Iterator[tuple[str, Any]]:
    """Names and functions of the recorded matches."""

    def run(name: str, scene: dict[str, Any], problem: rm.Problem, **options: Any) -> tuple[str, Any]:
        return name, lambda: rm.match(scene["source"], scene["target"], problem, **options)

    p3p, up2p, upright = rm.P3P(CAMERA), rm.UP2P(CAMERA), {"upright": True}
    between = rm.ThreePlusOne(CAMERA)
    for s in range(20):
        yield run(f"p3p-8+4-{s}", absolute(100 + s, 8, 4, 0.5), p3p, noise=0.5)
        yield run(f"up2p-8+6-{s}", absolute(200 + s, 8, 6, 0.5, **upright), up2p, noise=0.5)
        yield run(f"3p1-8+2-{s}", views(300 + s, 8, 2, 0.3, 2.0), between, noise=0.3)
    for s in range(15):
        yield run(f"p3p-guided-16+16-{s}", absolute(400 + s, 16, 16, 0.5), p3p, noise=0.5)
        yield run(f"up2p-guided-60+60-{s}", absolute(500 + s, 60, 60, 0.5, **upright), up2p, noise=0.5)
        scene = absolute(600 + s, 9, 5, 0.5)
        normals = scene["source"] / np.linalg.norm(scene["source"], axis=1, keepdims=True)
        yield run(f"p3p-normals-{s}", scene, p3p, noise=0.5, normals=normals)
        scene = absolute(700 + s, 9, 5, 0.5, **upright)
        mask = scene["rng"].random((9, 14)) < 0.9
        yield run(f"up2p-candidates-{s}", scene, up2p, noise=0.5, candidates=mask)
        yield run(f"p3p-paper-{s}", absolute(800 + s, 8, 0, 0.1), p3p, preset="paper", samples=50_000, seed=s)
    for s in range(10):
        yield run(
            f"up2p-motions-{s}", absolute(900 + s, 12, 4, 0.5, upright=True, motions=2), up2p, noise=0.5, motions=2
        )
        yield run(f"up2p-auto-motions-{s}", absolute(950 + s, 12, 0, 0.5, upright=True, motions=2), up2p, noise=0.5,
                  motions="auto")  # fmt: skip
        yield run(f"p3p-auto-noise-{s}", absolute(1000 + s, 9, 0, 0.7), p3p, noise="auto")
        scene = absolute(1100 + s, 9, 3, 0.5, **upright)
        yield run(f"up2p-noises-{s}", scene, up2p, noise=scene["rng"].uniform(0.3, 0.9, 12))
        yield run(f"up2p-normalised-{s}", absolute(1200 + s, 8, 3, 0.5, **upright), up2p, noise=0.5,
                  residual="normalised")  # fmt: skip
        yield run(f"3p1-baseline-{s}", views(1300 + s, 9, 2, 0.5, 0.3), rm.ThreePlusOne(CAMERA, small_baseline=1e-7),
                  noise=0.5)  # fmt: skip
        yield run(f"planar-{s}", views(1400 + s, 8, 0, 0.1, 1.0, planar=True), rm.PlanarMotion(CAMERA), noise=0.1)
        yield run(f"up2pf-{s}", absolute(1500 + s, 7, 1, 0.3, **upright), rm.UP2PF((320.0, 240.0)), noise=0.3)
        yield run(f"similarity-{s}", flat(1600 + s, 12, 4, 0.01, 2, 2.5), rm.Similarity(2), noise=0.01)
        yield run(f"rigid-{s}", flat(1700 + s, 12, 4, 0.01, 3, 1.0), rm.Rigid(3), noise=0.01)
        yield run(f"p3p-random-{s}", absolute(1800 + s, 9, 0, 0.5), p3p, noise=0.5, sampler="random", samples=200_000)
    for s in range(5):
        yield run(f"p3p-motions-{s}", absolute(1900 + s, 14, 0, 0.3, motions=2), p3p, noise=0.3, motions=2)
        yield run(f"p3p-rrwhm-{s}", absolute(2000 + s, 8, 2, 0.5), p3p, noise=0.5, solver="rrwhm")
        yield run(f"p3p-bcagm-{s}", absolute(2100 + s, 8, 2, 0.5), p3p, noise=0.5, solver="bcagm")
        yield run(f"p3p-hgm-{s}", absolute(2150 + s, 8, 2, 0.5), p3p, noise=0.5, solver="hgm")
        scene = absolute(2200 + s, 8, 6, 0.5)
        matcher = rm.Matcher(scene["source"], p3p, noise=0.5)
        yield f"p3p-matcher-{s}", lambda matcher=matcher, scene=scene: matcher.match(scene["target"])
        scene = views(2300 + s, 8, 0, 0.1, 1.0, planar=True)
        yield f"derived-{s}", lambda scene=scene: rm.match(scene["source"], scene["target"], derived_once(), noise=0.1)
    for s in range(13):
        yield run(f"up2p-unrelated-{s}", absolute(2400 + s, 3, 12, 0.5), up2p, noise=0.5)
        unrelated = {**absolute(2500 + s, 8, 0, 0.5), "target": absolute(2600 + s, 9, 0, 0.5)["target"]}
        yield run(f"p3p-unrelated-{s}", unrelated, p3p, noise=0.5)


_DERIVED: list[rm.Problem] = []


def derived_once() -> rm.Problem:
    """`derived`, cached."""
    if not _DERIVED:
        _DERIVED.append(derived())
    return _DERIVED[0]


def record(path: Path) -> None:
    """Write the result of every case."""
    found: dict[str, Any] = {}
    started = time.process_time()
    for name, make in cases():
        found[name] = described(make())
    temporary = path.with_suffix(".partial")
    temporary.write_text(json.dumps(found, indent=0))
    temporary.replace(path)
    print(f"{len(found)} matches in {time.process_time() - started:.0f} s of processor time: {path}")
    print(dict(Counter(entry["status"] for entry in found.values())))


def differs(old: Any, new: Any) -> bool:
    """Whether two recorded values differ by more than the last digits of numbers."""
    if isinstance(old, list) and isinstance(new, list):
        return len(old) != len(new) or any(differs(a, b) for a, b in zip(old, new, strict=True))
    if isinstance(old, float) and isinstance(new, float):
        return not math.isclose(old, new, rel_tol=TOLERANCE, abs_tol=TOLERANCE)
    return bool(old != new)


def compare(before: Path, after: Path) -> int:
    """Print the differences; returns 1 if there are any."""
    old, new = json.loads(before.read_text()), json.loads(after.read_text())
    missing = sorted(set(old) ^ set(new))
    changed: Counter[str] = Counter()
    for name in sorted(set(old) & set(new)):
        fields = [field for field in old[name] if differs(old[name][field], new[name].get(field))]
        changed.update(fields)
        if fields:
            print(f"{name}: {', '.join(fields)} differ")
            for field in ("status", "score", "hyperedges", "noise"):
                if field in fields:
                    print(f"    {field}: {old[name][field]} before, {new[name].get(field)} after")
    print(
        f"{len(set(old) & set(new))} matches compared, {len(missing)} in one recording only; changed: {dict(changed)}"
    )
    return int(bool(missing or changed))


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("record").add_argument("path", type=Path)
    two = commands.add_parser("compare")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    given = parser.parse_args()
    if given.command == "compare":
        return compare(given.before, given.after)
    record(given.path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
