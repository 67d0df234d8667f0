"""Random scenes of every kind, in search of one that is trusted and wrong: bodies, cameras, clutter, occlusion.

    python benchmarks/adversary.py --scenes 1000 --first-seed 3000000
    python benchmarks/adversary.py --scenes 200 --first-seed 1000 --rigs

A scene is drawn by its seed alone. One or two bodies: a cloud of 4 to 60 points, a planar ring (even, or nearly so), a
body with a mirror plane, one with half a turn, or a body and its mirror image; with normals and a view angle, or
without. A pinhole or a fisheye camera, P3P or UP2P. Clutter is uniform, crowded, or the image of a body that is not
looked for (a stretched copy among them). Points are undetected, hidden by half, or merged with a neighbour within a few
pixels into one detection at their mean, which `resolution=` tells. σ is .1 to 2 px and stated right; in a tenth of the
scenes no body is in view.

Counted by body: "right" is no match wrong and nine tenths of the visible points, "wrong" is trusted with a match that
is not true, "as many expected" what the told probabilities say of all that are trusted. A point of a merged detection
may have it; of a body with a symmetry only the drawn labels are true. "Pose off" is trusted with true matches and a
pose farther from the truth than its covariance lets one of 10,000 be.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from shared import Floats, head, parser, row, squared_error

import rootmatch as rm

SHAPES = ("cloud", "ring", "nearly even ring", "mirror plane", "half turn", "pair of mirror images")
CLUTTER = ("none", "uniform", "crowded", "another body", "a stretched copy")
SIZE = (1280, 960)
BODY, NEAR, VIEW = 0.12, 3.0, np.radians(70.0)


@dataclass
class Scene:
    """A drawn scene: what `rootmatch.match` is given, and the truth of each body."""

    kind: tuple[str, str]
    arguments: dict[str, Any]
    truths: list[list[set[int]]]
    """For each body and point, or sighting of a rig, the detections that are its own."""
    poses: list[tuple[Floats, Floats]]
    """Rotation and translation of each body."""


@dataclass
class Count:
    """What came of the bodies of one kind of scene."""

    bodies: int = 0
    shown: int = 0
    right: int = 0
    trusted: int = 0
    expected: float = 0.0
    wrong: int = 0
    off: int = 0
    seeds: list[int] = field(default_factory=list)


def shape(rng: np.random.Generator, kind: str) -> Floats:
    """Points (n, 3) of a body of some 12 cm."""
    n = int(rng.choice([4, 5, 6, 8, 12, 20, 40, 60]))
    points = rng.uniform(-BODY / 2, BODY / 2, (n, 3))
    if "ring" in kind:
        n = int(rng.integers(5, 16))
        angle = 2.0 * np.pi * np.arange(n) / n + (rng.uniform(-0.1, 0.1, n) if "nearly" in kind else 0.0)
        points = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)]) * BODY / 2
    elif kind == "mirror plane":
        points = np.concatenate([points[: n // 2 + 1], points[: n // 2 + 1] * (-1.0, 1.0, 1.0)])
    elif kind == "half turn":
        points = np.concatenate([points[: n // 2 + 1], points[: n // 2 + 1] * (-1.0, -1.0, 1.0)])
    return points


def drawn(seed: int) -> Scene:
    """The scene of a seed."""
    rng = np.random.default_rng([seed, 77])
    kind, clutter, bodies, normals = shapes(rng)
    sigma, facing = float(np.exp(rng.uniform(np.log(0.1), np.log(2.0)))), bool(rng.random() < 0.5)
    camera = rm.Camera(900.0, 900.0, 640.0, 480.0)
    if rng.random() < 0.3:
        camera = lens()
    absent = rng.random() < 0.1
    pixels: list[Floats] = []
    owners: list[list[tuple[int, int]]] = []
    poses = []
    for b, body in enumerate(bodies):
        R = Rotation.random(random_state=rng).as_matrix()
        t = np.array([rng.uniform(-0.25, 0.25), rng.uniform(-0.2, 0.2), rng.uniform(0.4, 2.0)])
        poses.append((R, t))
        if absent or (b and rng.random() < 0.5):
            continue
        places = body @ R.T + t
        seen = rng.random(len(body)) < rng.choice([1.0, 0.9, 0.7])
        if facing:
            cosine = -((normals[b] @ R.T) * places).sum(axis=1) / np.linalg.norm(places, axis=1)
            seen &= cosine > np.cos(VIEW)
        elif rng.random() < 0.3:
            seen &= places @ rng.normal(size=3) > 0.0
        image = camera.project(places)
        seen &= (image > 0).all(axis=1) & (image < SIZE).all(axis=1)
        for i in np.flatnonzero(seen).tolist():
            pixels.append(image[i])
            owners.append([(b, i)])
    merges = bool(rng.random() < 0.2 and sigma < 1.0)
    if merges:
        pixels, owners = merged(pixels, owners)
    count = int(rng.choice([2, 5, 10, 20]))
    if clutter in ("another body", "a stretched copy"):
        other = camera.project(stranger(rng, clutter, bodies[0]))
    else:
        other = drawn_clutter(rng, clutter, count)
    image = np.concatenate([np.reshape(pixels, (-1, 2)), other])
    image = image + rng.normal(0.0, sigma, image.shape)
    order = rng.permutation(len(image))
    truths: list[list[set[int]]] = [[set() for _ in body] for body in bodies]
    for place, k in enumerate(order.tolist()):
        for b, i in owners[k] if k < len(owners) else []:
            truths[b][i].add(place)
    problem: rm.Problem = rm.P3P(camera)
    if rng.random() < 0.3 and len(bodies) == 1:
        problem = tilted_vertical(rng, camera, poses[0][0])
    arguments = arguments_of(bodies, image[order], problem, sigma, seed, normals if facing else None)
    if merges:
        arguments["resolution"] = NEAR
    return Scene((kind, clutter), arguments, truths, poses)


def shapes(rng: np.random.Generator) -> tuple[str, str, list[Floats], list[Floats]]:
    """Kinds of body and of clutter, points of the bodies, and their normals."""
    kind, clutter = str(rng.choice(SHAPES)), str(rng.choice(CLUTTER))
    one = shape(rng, "cloud" if "pair" in kind else kind)
    bodies = [one, one * (-1.0, 1.0, 1.0)] if "pair" in kind else [one]
    return kind, clutter, bodies, [body / np.linalg.norm(body, axis=1, keepdims=True) for body in bodies]


def stranger(rng: np.random.Generator, clutter: str, one: Floats) -> Floats:
    """Points of a body that is not looked for, where it is seen."""
    points = one * (1.0, 1.15, 0.9) if "copy" in clutter else shape(rng, "cloud")
    turn = Rotation.random(random_state=rng).as_matrix()
    return points @ turn.T + np.array([*rng.uniform(-0.2, 0.2, 2), 0.9])


def drawn_clutter(rng: np.random.Generator, clutter: str, count: int) -> Floats:
    """Pixels of clutter that is no image of anything."""
    if clutter == "uniform":
        return rng.uniform((0, 0), SIZE, (count, 2))
    if clutter == "crowded":
        return rng.uniform((200, 200), (1000, 760)) + rng.normal(0.0, 30.0, (count, 2))
    return np.empty((0, 2))


def arguments_of(
    bodies: list[Floats], target: Floats, problem: rm.Problem, sigma: float, seed: int, normals: list[Floats] | None
) -> dict[str, Any]:
    """Arguments of `rootmatch.match`."""
    told: dict[str, Any] = {"source": np.concatenate(bodies), "target": target, "problem": problem}
    told |= {"noise": sigma, "seed": seed}
    if normals is not None:
        told |= {"normals": np.concatenate(normals), "view_angle": VIEW}
    if len(bodies) > 1:
        told["bodies"] = np.repeat(np.arange(len(bodies)), [len(body) for body in bodies])
    return told


def lens() -> rm.Camera:
    """A fisheye."""
    matrix = np.array([[330.0, 0.0, 640.0], [0.0, 330.0, 480.0], [0.0, 0.0, 1.0]])
    return rm.Camera.from_opencv_fisheye(matrix, [0.08, -0.02, 0.004, -0.0008])


def tilted_vertical(rng: np.random.Generator, camera: rm.Camera | rm.Rig, rotation: Floats) -> rm.UP2P:
    """The problem whose vertical is measured to half a degree."""
    tilt = Rotation.from_rotvec(rng.normal(0.0, np.radians(0.5), 3)).as_matrix()
    world, seen_down = rotation.T @ (0.0, 1.0, 0.0), tilt @ (0.0, 1.0, 0.0)
    return rm.UP2P(camera, vertical_camera=seen_down, vertical_world=world, vertical_noise=np.radians(0.5))


def merged(
    pixels: list[Floats], owners: list[list[tuple[int, int]]]
) -> tuple[list[Floats], list[list[tuple[int, int]]]]:
    """Detections of which those within a few pixels of each other are one, at their mean."""
    left = list(range(len(pixels)))
    image: list[Floats] = []
    whose: list[list[tuple[int, int]]] = []
    while left:
        k = left.pop(0)
        near = [j for j in left if np.linalg.norm(pixels[j] - pixels[k]) < NEAR]
        left = [j for j in left if j not in near]
        image.append(np.mean([pixels[j] for j in [k, *near]], axis=0))
        whose.append([owner for j in [k, *near] for owner in owners[j]])
    return image, whose


def judged(match: rm.Match, truth: list[set[int]]) -> tuple[bool, bool, int]:
    """Whether a body's match is right, whether any of it is wrong, and how many points are visible."""
    assignment = match.assignment if match.sightings is None else match.sightings.assignment.ravel()
    matched = [(i, int(j)) for i, j in enumerate(assignment) if j >= 0]
    wrong = any(j not in truth[i] for i, j in matched)
    shown = len({j for own in truth for j in own})
    return bool(shown) and not wrong and len(matched) >= 0.9 * shown, wrong, shown


def is_off(match: rm.Match, R: Floats, t: Floats) -> bool:
    """Whether the truth is outside the 99.99 % region of a pose."""
    pose = match.pose
    if pose is None or pose.covariance is None:
        return False  # too few matches in a camera
    return squared_error(pose, R, t) > chi2.ppf(0.9999, 6)


def main() -> None:
    """Match the scenes and print what came of each kind, and the seeds of what was trusted and wrong."""
    ask = parser(__doc__, scenes=200, first_seed=1000)
    ask.add_argument("--max-seconds", type=float, default=5.0, help="of each match")
    ask.add_argument("--rigs", action="store_true", help="scenes of several cameras, see adversary_rigs.py")
    given = ask.parse_args()
    drawn_by = import_module("adversary_rigs").drawn if given.rigs else drawn
    counts: dict[tuple[str, str], Count] = defaultdict(Count)
    for seed in range(given.first_seed, given.first_seed + given.scenes):
        scene = drawn_by(seed)
        try:
            match = rm.match(**scene.arguments, max_seconds=given.max_seconds)
        except rm.InputError:
            continue  # too few detections for one hyper-edge
        bodies = [match] if match.bodies is None else list(match.bodies.values())
        for body, truth, pose in zip(bodies, scene.truths, scene.poses, strict=True):
            right, wrong, shown = judged(body, truth)
            for key in (scene.kind, (scene.kind[0], "all"), ("all", scene.kind[1]), ("all", "all")):
                count = counts[key]
                count.bodies += 1
                count.shown += shown >= 5
                count.right += bool(body) and right and shown >= 5
                count.trusted += bool(body)
                count.expected += 1.0 - body.probability if body and body.probability is not None else 0.0
                off = bool(body) and not wrong and is_off(body, *pose)
                count.wrong += bool(body) and wrong
                count.off += off
                if body and (wrong or off):
                    count.seeds.append(seed)
    head(
        "body", "clutter", "bodies", "with five visible", "trusted and right", "trusted", "trusted and wrong",
        "as many expected", "pose off", "seeds",
    )  # fmt: skip
    for key, one in sorted(counts.items()):
        seeds = " ".join(map(str, one.seeds[:12]))
        row(*key, one.bodies, one.shown, one.right, one.trusted, one.wrong, f"{one.expected:.2f}", one.off, seeds)


if __name__ == "__main__":
    main()
