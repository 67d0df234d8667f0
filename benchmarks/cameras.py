"""What isotropic noise costs off the centre, and raw pixels against undistorted ones.

    python benchmarks/cameras.py noise     # residuals of true P3P hyper-edges by their angle to the optical axis
    python benchmarks/cameras.py raw DATA  # aicon_targets.npz: assignments from raw and from undistorted pixels

The kernels take one angle of noise for each detection; a pixel off the centre is longer in one direction than in the
other. The first table says how far the joint residual is from its distribution for that.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import rootmatch as rm
from rootmatch.problems.limits import GATE

K = np.array([[500.0, 0.0, 640.0], [0.0, 500.0, 480.0], [0.0, 0.0, 1.0]])
CAMERAS = {
    "pinhole": rm.Camera.from_matrix(K),
    "Brown, barrel": rm.Camera.from_opencv(K, [-0.15, 0.02, 1e-3, -2e-3]),
    "fisheye": rm.Camera.from_opencv_fisheye(K, [0.0, 0.0, 0.0, 0.0]),
    "bearings": rm.Bearings(),
}
RINGS = ((0, 20), (20, 40), (40, 55), (55, 70), (70, 90), (90, 120))
SCENES, SIGMA = 4000, 0.5


def residuals_of(camera: rm.Camera, low: float, high: float, seed: int) -> np.ndarray:
    """Joint residuals of hyper-edges whose four points are seen at angles from low to high degrees to the axis."""
    rng = np.random.default_rng(seed)
    sigma = SIGMA / 500.0 if camera.dimension == 3 else SIGMA
    found = []
    while len(found) < SCENES:
        cosine = rng.uniform(np.cos(np.deg2rad(high)), np.cos(np.deg2rad(low)), 4)
        # near one another, so that all four are stretched alike
        around = rng.uniform(0.0, 2.0 * np.pi) + rng.uniform(-0.6, 0.6, 4)
        sine = np.sqrt(1.0 - cosine**2)
        rays = np.column_stack([sine * np.cos(around), sine * np.sin(around), cosine])
        points = rays * rng.uniform(8.0, 12.0, (4, 1))
        if not camera.sees(points).all():
            return np.array([])
        image = camera.project(points)
        image = image + sigma * rng.standard_normal(image.shape)
        if not camera.shows(image).all():
            return np.array([])
        index = np.arange(4)[None]
        found.append(float(rm.residuals(points, image, rm.P3P(camera), index, index, noise=sigma)[0]))
    return np.array(found)


def noise() -> None:
    """Print the table of residuals; a χ² of 2 degrees of freedom has a median of 1.39 and 0.22 % beyond the gate."""
    print("| camera | degrees off the axis | longer side of a pixel over the shorter | median r² | beyond the gate |")
    print("|---|---|---|---|---|")
    for name, camera in CAMERAS.items():
        for low, high in RINGS:
            r = residuals_of(camera, low, high, seed=low)
            if len(r):
                middle = np.deg2rad(0.5 * (low + high))
                axes = np.linalg.svd(camera.jacobian([np.sin(middle), 0.0, np.cos(middle)]), compute_uv=False)
                # a root without its own prediction, or none, counts as beyond
                share = 100.0 * np.mean(~(r <= GATE))
                print(f"| {name} | {low}–{high} | {axes[0] / axes[1]:.2f} | {np.median(r**2):.2f} | {share:.1f} % |")


def raw(data: Path) -> None:
    """Print how often raw pixels give the assignment that undistorted ones give, with 40 + 10 points a view."""
    scene = np.load(data)
    points, image, K, dist = (scene[key] for key in ("points3d", "points2d", "K", "dist"))
    same = right = straight = views = 0
    seconds = np.zeros(2)
    for view in range(len(image)):
        seen = np.flatnonzero(np.isfinite(image[view]).all(axis=1))
        rng = np.random.default_rng(view)
        chosen = rng.permutation(seen)[:40]
        hidden = rng.permutation(np.setdiff1d(np.arange(len(points)), seen))[:10]
        source = rng.permutation(np.concatenate([chosen, hidden]))
        pixels = image[view][chosen]
        camera, pinhole = rm.Camera.from_opencv(K[view], dist), rm.Camera.from_matrix(K[view])
        truth = np.full(len(source), -1)
        for k, i in enumerate(chosen):
            truth[source == i] = k
        found = []
        for side, (model, detections) in enumerate(
            ((camera, pixels), (pinhole, pinhole.project(camera.bearings(pixels))))
        ):
            started = time.perf_counter()
            found.append(rm.match(points[source], detections, rm.P3P(model), noise=0.5).assignment)
            seconds[side] += time.perf_counter() - started
        ignored = rm.match(points[source], pixels, rm.P3P(pinhole), noise=0.5).assignment
        views += 1
        same += np.array_equal(found[0], found[1])
        right += np.array_equal(found[0][truth >= 0], truth[truth >= 0])
        straight += np.array_equal(ignored[truth >= 0], truth[truth >= 0])
        print(f"\r{views} views", end="", file=sys.stderr)
    print(f"\n{views} views: the same assignment from raw and from undistorted pixels in {same}, all right in {right},")
    print(f"and in {straight} where the distortion is ignored; {seconds[0]:.1f} s and {seconds[1]:.1f} s")


if __name__ == "__main__":
    if sys.argv[1:2] == ["noise"]:
        noise()
    elif sys.argv[1:2] == ["raw"] and len(sys.argv) == 3:
        raw(Path(sys.argv[2]))
    else:
        sys.exit(__doc__)
