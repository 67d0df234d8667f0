"""Scenes of `accuracy.py`: simulated, symmetric and measured ones, with ground truth and goals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from shared import Floats, Integers, measured_data

import rootmatch as rm
from rootmatch.research.real import scenes as real
from rootmatch.research.real.methods import make_problem
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene

PRIOR = 3e-8
"""ρ of the small-baseline prior."""


@dataclass(frozen=True)
class Instance:
    """One scene to match."""

    problem: rm.Problem
    source: Floats
    target: Floats
    truth: Integers
    noise: Any
    labels: Integers
    """Motion of each source point, −1 without image."""
    options: dict[str, Any] = field(default_factory=dict)
    """Arguments of `rootmatch.match`: knowledge of the scene, never a parameter of the method."""
    pose: tuple[Floats, Floats] | None = None
    """Between two views: the true one."""


@dataclass(frozen=True)
class Case:
    """A kind of scene and the goals for it."""

    table: str
    name: str
    make: Callable[[int], Instance]
    reach: dict[str, float] = field(default_factory=dict)
    """Least mean of a figure of `accuracy.Outcome`; "own − …" is the true geometry's own less so much."""
    scenes: int = 100
    """Most scenes of this kind (measured data are limited; the largest are expensive)."""
    yardstick: str = "single"
    """What the yardstick does here: "single", "joint", "peel" (one motion, then another) or "none"."""


def of_scene(scene: Scene, **options: Any) -> Instance:
    """An instance of a simulated scene."""
    return Instance(
        scene.problem, scene.source, scene.target, scene.truth, scene.noise, scene.motions, options,
        scene.poses[0] if scene.problem.source_dimension == 2 else None,
    )  # fmt: skip


def simulated() -> list[Case]:
    """The paper's scenes: noise, clutter, occlusion, several motions, candidates."""
    cases = []
    reach = {(10, 0, 1.0): (0.995, 1.0), (10, 10, 1.0): (0.99, 0.995), (10, 10, 2.0): (0.98, 0.99),
             (20, 20, 1.0): (0.99, 0.995)}  # fmt: skip
    for (n, clutter, sigma), wanted in reach.items():
        for make, minimum in zip((p3p_scene, up2p_scene), wanted, strict=True):
            cases.append(
                Case(
                    "noise and clutter", f"{make.__name__[:-6]} {n} + {clutter}, σ {sigma:g}",
                    lambda seed, make=make, n=n, k=clutter, s=sigma: of_scene(make(n, k, s, seed)),
                    {"accuracy": minimum},
                )
            )  # fmt: skip
    for baseline, clutter, below in ((1.0, 0, 0.01), (1.0, 10, 0.02), (5.0, 0, 0.04), (5.0, 10, 0.06)):
        for prior in (False, True):
            cases.append(
                Case(
                    "two views", f"3p1 b {baseline:g}, 10 + {clutter}, σ 1{', small-baseline prior' if prior else ''}",
                    lambda seed, k=clutter, b=baseline, prior=prior: two_views(k, b, seed, prior),
                    {} if prior else {"own": below}, yardstick="none",
                )
            )  # fmt: skip
    for make in (p3p_scene, up2p_scene):
        cases.append(
            Case(
                "occlusion", f"{make.__name__[:-6]} 10 visible of 20 + 10, σ 0.5",
                lambda seed, make=make: of_scene(make(10, 10, 0.5, seed, hidden=10)),
                {"accuracy": 0.97, "precision": 0.98},
            )
        )  # fmt: skip
    for count, minimum in ((2, 0.99), (4, 0.98), (8, 0.97)):
        for asked in (count, "auto"):
            cases.append(
                Case(
                    "motions", f'up2p {count} × 5, σ 1, motions={asked}',
                    lambda seed, k=count, asked=asked: of_scene(up2p_scene(5 * k, 0, 1.0, seed, k), motions=asked),
                    {"accuracy": minimum, "rand": 0.95}, scenes=20 if count == 8 else 100,
                    yardstick="joint" if asked == "auto" else "none",
                )
            )  # fmt: skip
    for asked in (2, "auto"):
        cases.append(
            Case(
                "motions", f"up2p 2 × 5 + 10, σ 1, motions={asked}",
                lambda seed, asked=asked: of_scene(up2p_scene(10, 10, 1.0, seed, 2), motions=asked),
                {"accuracy": 0.96, "rand": 0.95}, yardstick="joint" if asked == "auto" else "none",
            )
        )  # fmt: skip
        cases.append(
            Case(
                "motions", f"p3p 2 × 8, σ 0.5, motions={asked}",
                lambda seed, asked=asked: of_scene(p3p_scene(16, 0, 0.5, seed, 2), motions=asked),
                {"accuracy": 0.97, "rand": 0.95}, yardstick="peel" if asked == "auto" else "none",
            )
        )  # fmt: skip
    return cases


def two_views(clutter: int, baseline: float, seed: int, prior: bool) -> Instance:
    """Two views, with or without the prior for views from nearly one place."""
    instance = of_scene(three_plus_one_scene(10, clutter, 1.0, seed, baseline))
    if prior:
        instance = replace(instance, problem=replace(instance.problem, small_baseline=PRIOR))
    return instance


def ambiguous() -> list[Case]:
    """Scenes with and without a twin: objects that are nearly symmetric, near and far."""
    return [
        Case("ambiguity", "p3p without symmetry", lambda seed: plain(seed), yardstick="none"),
        Case("ambiguity", "p3p inside-out twin", lambda seed: symmetric(seed, "centre"), yardstick="none"),
        Case("ambiguity", "p3p half-turn twin", lambda seed: symmetric(seed, "axis"), yardstick="none"),
        Case("ambiguity", "up2p without symmetry", lambda seed: plain(seed, up2p_scene), yardstick="none"),
        Case("ambiguity", "up2p half-turn twin", lambda seed: symmetric(seed, "axis", True), yardstick="none"),
    ]


def plain(seed: int, make: Callable[..., Scene] = p3p_scene) -> Instance:
    """A scene of the paper of any size, noise, clutter and occlusion."""
    rng = np.random.default_rng([seed, 1])
    n, clutter, hidden = rng.integers(6, 13), rng.integers(0, 11), rng.integers(0, 5)
    return of_scene(make(int(n), int(clutter), float(rng.uniform(0.2, 2.0)), seed, hidden=int(hidden)))


def symmetric(seed: int, kind: str, upright: bool = False) -> Instance:
    """Pairs of points that the symmetry swaps, moved off it by an amount that is seen, or just not seen.

    The symmetry about the centre maps the image of a distant object onto itself turned inside out, the closer the more
    distant it is; the half turn maps a pose onto another one exactly.
    """
    rng = np.random.default_rng([seed, 2])
    pairs, clutter = int(rng.integers(4, 7)), int(rng.integers(0, 6))
    half = rng.uniform(-1.0, 1.0, (pairs, 3))
    turned = -half if kind == "centre" else half * [-1.0, 1.0, -1.0]
    sigma = float(rng.uniform(0.2, 1.0))
    distance = float(10.0 ** rng.uniform(0.6, 2.0)) if kind == "centre" else 8.0
    focal = 150.0 * distance
    # an offset of one σ of the image is distance σ / focal in space
    offset = float(10.0 ** rng.uniform(-1.0, 1.3)) * sigma / 150.0 * (0.2 if kind == "centre" else 1.0)
    points = np.concatenate([half, turned + offset * rng.normal(size=half.shape)])
    camera = rm.Camera(focal, focal, 320.0, 240.0)
    if upright:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
        tilt = 0.3
        lean = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(tilt), -np.sin(tilt)], [0.0, np.sin(tilt), np.cos(tilt)]])
        rotation = lean @ turn
        problem: rm.Problem = rm.UP2P(camera, vertical_camera=tuple(lean[:, 1]), vertical_world=(0.0, 1.0, 0.0))
    else:
        rotation, triangle = np.linalg.qr(rng.normal(size=(3, 3)))
        rotation = rotation * np.sign(np.diag(triangle))
        rotation[:, 2] *= np.linalg.det(rotation)
        problem = rm.P3P(camera)
    image = camera.project(points @ rotation.T + [0.0, 0.0, distance]) + sigma * rng.normal(size=(2 * pairs, 2))
    spread = np.ptp(image, axis=0)
    image = np.concatenate([image, image.min(axis=0) + spread * rng.uniform(0.0, 1.0, (clutter, 2))])
    order = rng.permutation(len(image))
    truth = np.argsort(order)[: 2 * pairs]
    return Instance(problem, points, image[order], truth, sigma, np.zeros(2 * pairs, np.int64))


def measured() -> list[Case]:
    """The measured sets."""
    table = "measured"
    cases = []
    for view in range(4):
        for normals in (True, False):
            cases.append(
                Case(
                    table, f"headset view {view}{' with normals' if normals else ''}",
                    lambda seed, view=view, normals=normals: headset(view, normals, seed),
                    {"accuracy": 1.0, "precision": 1.0} if normals else {"shown": 1.0}, scenes=1,
                    yardstick="none" if normals else "single",
                )
            )  # fmt: skip
    cases.append(
        Case(table, "dots 20 + 40 real clutter", lambda seed: dots(seed), {"accuracy": 0.97, "precision": 0.97}, 40)
    )
    cases.append(Case(table, "film tracks, all views", lambda seed: film(seed), {"accuracy": 0.98}, 16))
    cases.append(
        Case(table, "façade up2p 15 + 15, exact vertical", lambda seed: facade(seed, False), {"accuracy": 0.97}, 20)
    )
    cases.append(
        Case(table, "façade up2p 15 + 15, measured vertical", lambda seed: facade(seed, True), {"accuracy": 0.93}, 20)
    )
    for exact in (True, False):
        cases.append(
            Case(
                table, f"façade 3p1 12, {'exact' if exact else 'measured'} vertical",
                lambda seed, exact=exact: facade_pair(seed, exact), {"own": 0.05}, 20, "none",
            )
        )  # fmt: skip
    for asked in (2, "auto"):
        cases.append(
            Case(
                table, f"board 8 + 8 of two poses, motions={asked}", lambda seed, asked=asked: boards(seed, asked),
                {"accuracy": 0.95, "rand": 0.95}, 20, "peel" if asked == 2 else "none",
            )
        )  # fmt: skip
    return cases


def of_real(scene: real.RealScene | None, **options: Any) -> Instance:
    """An instance of a scene of `rootmatch benchmark real`."""
    assert scene is not None
    assert scene.truth is not None
    request, truth = scene.request, scene.truth
    if "normals" in request:
        options["normals"] = request["normals"]
    points = (np.array(request[name]) for name in ("source", "target"))
    return Instance(make_problem(request), *points, truth, request["noise"], np.where(truth < 0, -1, 0), options)


def headset(view: int, normals: bool, seed: int) -> Instance:
    """All sensors of the headset against those visible in one view."""
    return of_real(real.headset(measured_data("vive_hmd_lighthouse"), 4 * seed + view, normals=normals))


def dots(seed: int) -> Instance:
    """20 random dots of a view and 40 of the false detections in it; four views in turn."""
    return of_real(real.dots(measured_data("openptv_cavity_target"), seed))


def film(seed: int) -> Instance:
    """All tracks against those of one frame; the frames in turn."""
    return of_real(real.film(measured_data("tears_of_steel_01"), seed))


def facade(seed: int, measured_vertical: bool) -> Instance:
    """15 random points of a view and 15 other features of it as clutter; three views in turn."""
    return of_real(real.facade(measured_data("berlin_facade"), seed, measured=measured_vertical))


def facade_pair(seed: int, exact: bool) -> Instance:
    """12 random points visible in two of the three views."""
    data = measured_data("berlin_facade")
    first, second = [(0, 1), (1, 2), (0, 2)][seed % 3]
    scene = real.facade_pair(data, seed)
    if not exact:
        axes = dict(zip(("axis", "axis2"), data["gravity_cam_measured"][[first, second]].tolist(), strict=True))
        scene.request.update(axes, axis_noise=real.VERTICAL_NOISE)
    rotation = data["R"][second] @ data["R"][first].T
    return replace(of_real(scene), pose=(rotation, data["t"][second] - rotation @ data["t"][first]))


def boards(seed: int, asked: int | str) -> Instance:
    """8 corners of one pose of the board and 8 others of another pose, in one image."""
    data = measured_data("opencv_chessboard_stereo")
    rng = np.random.default_rng(seed)
    camera = rng.integers(0, 2)
    views = np.flatnonzero(data["camera_id"] == np.unique(data["camera_id"])[camera])
    first, second = rng.choice(views, 2, replace=False)
    chosen = rng.choice(len(data["points3d"]), 16, replace=False)
    image = np.concatenate([data["points2d"][first][chosen[:8]], data["points2d"][second][chosen[8:]]])
    order = rng.permutation(16)
    labels = (np.arange(16) // 8)[order]
    points, image = data["points3d"][chosen][order], image[order]
    shuffle = rng.permutation(16)
    problem = rm.P3P(rm.Camera.from_matrix(data["K"][first]))
    noise = float(np.sqrt(np.mean(data["rms_px"][[first, second]] ** 2)))
    return Instance(problem, points, image[shuffle], np.argsort(shuffle), noise, labels, {"motions": asked})
