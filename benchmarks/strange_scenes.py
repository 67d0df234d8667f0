"""Scenes of kinds that nothing was tuned on: rows of `together.py`.

``stereo``: a ring of 16 LEDs before two cameras 6 cm apart, half of it beyond the edge of one. ``wand``: five LEDs
within 5 mm of a line, three of them evenly spaced, two on its handle. ``tools``: two tools of the same six points in
one image; nobody can say which is which, so neither must be trusted. ``board``: the 20 corners of a checkerboard of 5
by 6 squares, 70 % of them detected; half a turn maps it onto itself, so it must not be trusted. ``cut-board``: the same
without two corners, which tell its halves apart. ``cube``: eight corners with normals; 24 turns map it onto itself.
``stray``: twelve points, one of them detected 6 to 40 px off. ``two-scales``: six points within 2 cm and six within
40 cm. ``unnamed-copy``: two of the same object, of which one is asked for, so it must not be trusted. ``reflection``:
ten points over a glossy table that shows them once more, upside down. ``near-board``: 9 by 7 dots of which the image
shows a part, so that rows and columns may be counted from anywhere, and it must not be trusted. ``hidden-wand``: four
or five LEDs on a line and one beside it, which is hidden: both readings of the line fit. ``markers``: a tool of four to
six markers without normals before two to four cameras, each of which shows three of them. ``family``: three bodies
that differ by one LED, all given, of which one or two are in view. ``other-board``: another board on the same squares
is in view, larger, smaller or as large, each with its own corners missing; no answer is right. ``own-board``: the board
itself. ``part-board``: the same as a part of a larger one that is in view as well.

The two tools may change places. A stray point may be matched with its own detection or be left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
SIZE = np.array([1280.0, 960.0])
NOISE = 0.4
VIEW = np.radians(70.0)


@dataclass
class Scene:
    """Arguments of `rootmatch.match`, and the detection of each point of each image, −1 for none."""

    told: dict[str, Any]
    truth: list[Integers]


def pose(rng: np.random.Generator, near: float, far: float) -> tuple[Floats, Floats]:
    """Any rotation, at a place in view."""
    z = rng.uniform(near, far)
    pixel = rng.uniform(0.2 * SIZE, 0.8 * SIZE)
    return Rotation.random(random_state=rng).as_matrix(), np.array([*((pixel - SIZE / 2) / 900.0 * z), z])


def detected(
    rng: np.random.Generator, points: Floats, shown: NDArray[np.bool_], clutter: int
) -> tuple[Floats, Integers]:
    """Shuffled detections of points in the camera frame with clutter, and the detection of each point."""
    pixels = CAMERA.project(points) + rng.normal(0.0, NOISE, (len(points), 2))
    index = np.flatnonzero(shown & (pixels > 0).all(axis=1) & (pixels < SIZE).all(axis=1) & (points[:, 2] > 0.05))
    every = np.concatenate([pixels[index], rng.uniform((0.0, 0.0), SIZE, (clutter, 2))])
    order = rng.permutation(len(every))
    truth = np.full(len(points), -1)
    truth[index] = np.argsort(order)[: len(index)]
    return every[order], truth


def facing(points: Floats, normals: Floats) -> NDArray[np.bool_]:
    """Which points face a camera at the origin."""
    cosine = -(points * normals).sum(axis=1) / np.linalg.norm(points, axis=1) / np.linalg.norm(normals, axis=1)
    return np.asarray(cosine > np.cos(VIEW))


def stereo(rng: np.random.Generator) -> Scene:
    """A rig of two cameras, one of which sees half of the body."""
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 16))
    source = np.column_stack([0.06 * np.cos(angle), 0.06 * np.sin(angle), rng.uniform(-0.01, 0.01, 16)])
    normals = np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(-0.5, 1.0, 16)])
    R = Rotation.random(random_state=rng).as_matrix()
    z = rng.uniform(0.3, 0.8)
    place = np.array([-640.0 / 900.0 * z + rng.uniform(0.02, 0.1), rng.uniform(-0.3, 0.3) * z, z])
    first = source @ R.T + place
    second = first - np.array([0.06, 0.0, 0.0])
    parts = [detected(rng, one, facing(one, normals @ R.T), 4) for one in (first, second)]
    camera = np.repeat([0, 1], [len(target) for target, _ in parts])
    views = [(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, np.eye(3), np.array([-0.06, 0.0, 0.0]))]
    problem = rm.P3P(rm.Rig(views, sizes=[tuple(SIZE.astype(int).tolist())] * 2))
    shift = len(parts[0][0])
    truth = [parts[0][1], np.where(parts[1][1] >= 0, parts[1][1] + shift, -1)]
    target = np.concatenate([one for one, _ in parts])
    told = {"source": source, "target": (target, camera), "problem": problem, "normals": normals, "view_angle": VIEW}
    return Scene(told, truth)


def cloud(rng: np.random.Generator, source: Floats, clutter: int, rate: float = 0.95, **more: Any) -> Scene:
    """Points without normals, each detected with a rate."""
    R, t = pose(rng, 0.6, 2.0)
    target, truth = detected(rng, source @ R.T + t, rng.random(len(source)) < rate, clutter)
    return Scene({"source": source, "target": target, "problem": rm.P3P(CAMERA), **more}, [truth])


def wand(rng: np.random.Generator) -> Scene:
    """Nearly collinear LEDs."""
    line = np.column_stack([[0.0, 0.05, 0.10, 0.15, 0.23], *rng.uniform(-0.005, 0.005, (2, 5))])
    return cloud(rng, np.concatenate([line, [[0.02, 0.06, 0.0], [0.04, 0.03, 0.05]]]), 5)


def tools(rng: np.random.Generator) -> Scene:
    """Two of the same."""
    one = rng.uniform(-0.08, 0.08, (6, 3))
    placed = []
    for _ in range(2):
        R, t = pose(rng, 0.6, 1.5)
        placed.append(one @ R.T + t)
    target, truth = detected(rng, np.concatenate(placed), rng.random(12) < 0.95, 5)
    told = {"source": np.tile(one, (2, 1)), "target": target, "problem": rm.P3P(CAMERA), "bodies": [0] * 6 + [1] * 6}
    return Scene(told, [truth])


def corners() -> Floats:
    """Inner corners of a checkerboard of 5 by 6 squares of 3 cm."""
    x, y = np.meshgrid(0.03 * np.arange(5.0), 0.03 * np.arange(4.0))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(20)])


def cube(rng: np.random.Generator) -> Scene:
    """Corners of a cube that hides its back."""
    source = 0.05 * np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    R, t = pose(rng, 0.4, 1.2)
    points = source @ R.T + t
    target, truth = detected(rng, points, facing(points, source @ R.T), 3)
    told = {"source": source, "target": target, "problem": rm.P3P(CAMERA), "normals": source, "view_angle": VIEW}
    return Scene(told, [truth])


def stray(rng: np.random.Generator) -> Scene:
    """One detection far off."""
    made = cloud(rng, rng.uniform(-0.1, 0.1, (12, 3)), 4, 0.9)
    (truth,) = made.truth
    point = rng.choice(np.flatnonzero(truth >= 0))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    made.told["target"][truth[point]] += rng.uniform(6.0, 40.0) * np.array([np.cos(angle), np.sin(angle)])
    made.truth.append(np.where(np.arange(12) == point, -1, truth))
    return made


def unnamed_copy(rng: np.random.Generator) -> Scene:
    """Two of the same, one asked for: no answer is right."""
    one = rng.uniform(-0.08, 0.08, (int(rng.choice([5, 8, 12, 20])), 3))
    placed = []
    for _ in range(2):
        R, t = pose(rng, 0.6, 1.5)
        placed.append(one @ R.T + t)
    target, _ = detected(rng, np.concatenate(placed), rng.random(2 * len(one)) < 0.95, 5)
    return Scene({"source": one, "target": target, "problem": rm.P3P(CAMERA)}, [np.full(len(one), -1)])


def reflection(rng: np.random.Generator) -> Scene:
    """An object and its mirror image below a table that the camera looks down on."""
    one = rng.uniform(-0.08, 0.08, (10, 3))
    tilt = Rotation.from_euler("x", rng.uniform(-60.0, -20.0), degrees=True).as_matrix()
    above = one @ Rotation.random(random_state=rng).as_matrix().T + (0.0, -rng.uniform(0.12, 0.25), 0.0)
    far = np.array([rng.uniform(-0.1, 0.1), 0.0, rng.uniform(0.8, 1.4)])
    placed = [places @ tilt.T + far for places in (above, above * (1.0, -1.0, 1.0))]
    shown = rng.random(20) < np.repeat([0.95, 0.8], 10)
    target, truth = detected(rng, np.concatenate(placed), shown, 3)
    return Scene({"source": one, "target": target, "problem": rm.P3P(CAMERA)}, [truth[:10]])


def near_board(rng: np.random.Generator) -> Scene:
    """A part of a grid."""
    x, y = np.meshgrid(0.03 * np.arange(9.0), 0.03 * np.arange(7.0))
    source = np.column_stack([x.ravel(), y.ravel(), np.zeros(63)]) - (0.12, 0.09, 0.0)
    R = Rotation.from_euler("xyz", rng.uniform(-0.5, 0.5, 3)).as_matrix()
    t = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.1, 0.2)])
    target, _ = detected(rng, source @ R.T + t, rng.random(63) < 0.95, 0)
    return Scene({"source": source, "target": target, "problem": rm.P3P(CAMERA)}, [np.full(63, -1)])


def hidden_wand(rng: np.random.Generator) -> Scene:
    """Points on a line; the one beside it has no image."""
    places = np.sort(rng.uniform(-0.1, 0.1, int(rng.integers(4, 6))))
    source = np.concatenate([np.column_stack([places, np.zeros((len(places), 2))]), [[0.01, 0.04, 0.02]]])
    R, t = pose(rng, 0.6, 2.0)
    shown = np.arange(len(source)) < len(places)
    target, truth = detected(rng, source @ R.T + t, shown, int(rng.choice([0, 2])))
    return Scene({"source": source, "target": target, "problem": rm.P3P(CAMERA)}, [truth])


def markers(rng: np.random.Generator) -> Scene:
    """Three of a few markers in each camera of a rig."""
    n, count = int(rng.integers(4, 7)), int(rng.integers(2, 5))
    source, views, parts, shift = rng.uniform(-0.08, 0.08, (n, 3)), [], list[tuple[Floats, Integers]](), 0
    R, t = Rotation.random(random_state=rng).as_matrix(), rng.uniform((-0.2, -0.2, 1.2), (0.2, 0.2, 1.8))
    for k in range(count):
        place = k - 0.5 * (count - 1)
        turn = Rotation.from_euler("y", 0.35 * place).as_matrix()
        views.append((CAMERA, turn, -turn @ (0.5 * place, 0.0, 0.0)))
        shown = np.zeros(n, np.bool_)
        shown[rng.permutation(n)[:3]] = True
        target, own = detected(rng, (source @ R.T + t - (0.5 * place, 0.0, 0.0)) @ turn.T, shown, int(rng.integers(2)))
        parts.append((target, np.where(own >= 0, own + shift, -1)))
        shift += len(target)
    camera = np.repeat(np.arange(count), [len(target) for target, _ in parts])
    problem = rm.P3P(rm.Rig(views, sizes=[tuple(SIZE.astype(int).tolist())] * count))
    told = {"source": source, "target": (np.concatenate([one for one, _ in parts]), camera), "problem": problem}
    return Scene(told, [own for _, own in parts])


def family(rng: np.random.Generator) -> Scene:
    """Three bodies of seven LEDs or eight: one of them is elsewhere on the second, and the third has one more."""
    first = rng.uniform(-0.12, 0.12, (7, 3))
    second, way = first.copy(), rng.normal(size=3)
    second[0] += rng.uniform(0.01, 0.05) * way / np.linalg.norm(way)
    every = [first, second, np.concatenate([first, rng.uniform(-0.12, 0.12, (1, 3))])]
    order, count = rng.permutation(3), int(rng.integers(1, 3))
    placed, shown = [], []
    for place, k in enumerate(order):  # any of them may be in view
        R, t = pose(rng, 0.8, 2.5)
        placed.append(every[k] @ R.T + t)
        shown.append(rng.random(len(every[k])) < (0.95 if place < count else 0.0))
    target, truth = detected(rng, np.concatenate(placed), np.concatenate(shown), 4)
    labels = np.repeat(order, [len(every[k]) for k in order])
    told = {"source": np.concatenate([every[k] for k in order]), "target": target, "problem": rm.P3P(CAMERA)}
    return Scene({**told, "bodies": labels}, [truth])


def holed(rng: np.random.Generator, columns: int, rows: int, holes: int) -> Floats:
    """Corners of a board of squares of 3 cm, some of them missing."""
    x, y = np.meshgrid(0.03 * np.arange(columns), 0.03 * np.arange(rows))
    every = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return every[np.sort(rng.permutation(len(every))[holes:])]


def on_squares(rng: np.random.Generator, source: Floats, points: Floats) -> Scene:
    """A board that is asked for, and what is in view: the board and more, or something else."""
    R = Rotation.from_rotvec(rng.normal(0.0, 0.4, 3)).as_matrix()
    target, truth = detected(
        rng, points @ R.T + rng.normal((-0.1, -0.07, 0.5), 0.03), rng.random(len(points)) < 0.95, 4
    )
    own = len(points) >= len(source) and bool((points[: len(source)] == source).all())
    return Scene(
        {"source": source, "target": target, "problem": rm.P3P(CAMERA)},
        [truth[: len(source)] if own else np.full(len(source), -1)],
    )


def other_board(rng: np.random.Generator) -> Scene:
    """Another board on the same squares."""
    columns, rows, holes = rng.choice([(7, 7, 5), (9, 6, 6), (6, 6, 3), (10, 8, 8), (8, 6, 6)])
    return on_squares(rng, holed(rng, 8, 6, 6), holed(rng, columns, rows, holes))


def own_board(rng: np.random.Generator) -> Scene:
    """The board itself."""
    source = holed(rng, 8, 6, 6)
    return on_squares(rng, source, source)


def part_board(rng: np.random.Generator) -> Scene:
    """The board as a part of a larger one."""
    whole = holed(rng, 11, 9, 18)
    own = (whole[:, 0] < 0.225) & (whole[:, 1] < 0.165)
    return on_squares(rng, whole[own], np.concatenate([whole[own], whole[~own]]))


KINDS = {
    "stereo": stereo,
    "wand": wand,
    "tools": tools,
    "board": lambda rng: cloud(rng, corners(), 4, 0.7),
    "cut-board": lambda rng: cloud(rng, np.delete(corners(), [3, 4], axis=0), 4, 0.7),
    "cube": cube,
    "stray": stray,
    "two-scales": lambda rng: cloud(
        rng, np.concatenate([rng.uniform(-0.01, 0.01, (6, 3)), rng.uniform(-0.2, 0.2, (6, 3))]), 5
    ),
    "unnamed-copy": unnamed_copy,
    "reflection": reflection,
    "near-board": near_board,
    "hidden-wand": hidden_wand,
    "markers": markers,
    "family": family,
    "other-board": other_board,
    "own-board": own_board,
    "part-board": part_board,
}
