"""How often an image's `probability` and `confidence` are right, by bins of ten, for each geometry and kind of scene.

    python benchmarks/calibration.py --scenes 100 --first-seed 1000

"drawn" scenes come from the model's own priors (docs/model.md): whether the body is in view, its pose, the factor on σ,
the detection rate, what is hidden as a whole, the number of clutter points, and uniform clutter. There what is told
has to be right; elsewhere it is as right as the priors are. "against" are the scenes of `adversary.py`, without those
whose clutter is a stretched copy of the body, which is not in the model; "twins" and "plain" those of `accuracy.py`.
Others are those of `constellations.py` and `few_leds` of `evidence.py`.

The probability of a match that is trusted is that of the matches that it keeps; that of another one is of the whole
assignment. Each bin has its number, the scenes that these are of, the mean told, the share that is right and its 95 %
interval, which counts scenes (Kish 1965). A bin holds if that share is within .03 of the mean told, or the mean within
the interval. "Points" are those with a match, and those without one apart.
"""

from __future__ import annotations

import itertools
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import adversary
import adversary_rigs
import numpy as np
from accuracy_scenes import plain, symmetric
from constellations import arguments as constellation
from evidence import few_leds
from reliability import WITHIN, effective, interval
from scipy.spatial.transform import Rotation
from scipy.special import gammaln
from shared import Floats, append_csv, head, parser, row, scenes_of

import rootmatch as rm
from rootmatch.simulation import up2p_scene

SIZE, FOCAL = 1280.0, 667.0
"""Of an image that fills 2 sr, as the prior of positions does."""
NEAREST, FARTHEST = 2.0, 200.0
"""Distances of a drawn body, over its root mean square radius: a factor of 100."""
VIEW, SLOPE, EDGE = np.radians(70.0), 1.702, 0.03
"""View angle, and the logistic curve of its edge in cosines."""
MOST = 16
"""Largest number of clutter points that are drawn; scenes with more detections in an image are left out, as the model
allows for more of them."""
PRESENT, HIDDEN = 0.8, 0.05
KINDS = ("probability", "matched points", "unmatched points")


@dataclass(frozen=True)
class Scene:
    """What `rootmatch.match` is given, and the detections of each point, or sighting, of each body."""

    geometry: str
    arguments: dict[str, Any]
    truths: list[list[set[int]]]


@dataclass(frozen=True)
class Outcome:
    """What was told of a body of a scene, and whether it was so."""

    family: str
    geometry: str
    seed: int
    status: str
    probability: float
    held: int
    points: str
    """Of each point: its confidence, whether it has a match, and whether that, or having none, is right."""


@dataclass
class Table:
    """What was told of one kind, and of which scene."""

    told: list[float] = field(default_factory=list)
    held: list[bool] = field(default_factory=list)
    scene: list[int] = field(default_factory=list)

    def rows(self) -> Iterator[tuple[object, ...]]:
        """A row for each bin that is not empty."""
        told, held, scene = np.array(self.told), np.array(self.held), np.array(self.scene)
        place = np.minimum((told * 10).astype(int), 9)
        for k in range(10):
            if (own := place == k).any():
                mean, share = float(told[own].mean()), float(held[own].mean())
                count = effective(np.unique(scene[own], return_counts=True)[1])
                low, high = interval(share * count, count)
                good = abs(share - mean) <= WITHIN or low <= mean <= high
                scenes = len(np.unique(scene[own]))
                yield (
                    f"{k / 10:.1f}", int(own.sum()), scenes, f"{mean:.3f}", f"{share:.3f}", f"{low:.3f} – {high:.3f}",
                    "yes" if good else "no",
                )  # fmt: skip


def body(rng: np.random.Generator, least: int = 4) -> tuple[Floats, Floats]:
    """Points (n, 3) in a ball, and normals that point away from its centre."""
    n = int(rng.integers(least, 13))
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = directions * np.cbrt(rng.uniform(0.2, 1.0, (n, 1)))
    return points - points.mean(axis=0), directions


def place(rng: np.random.Generator, points: Floats) -> tuple[Floats, Floats]:
    """Any pose of a body about its centre, in the field of the camera."""
    radius = float(np.sqrt((points**2).sum(axis=1).mean()))
    pixel = rng.uniform(0.0, SIZE, 2)
    while True:  # directions are uniform in solid angle
        ray = np.array([*((pixel - SIZE / 2) / FOCAL), 1.0])
        if rng.random() < np.linalg.norm(ray) ** -3:
            break
        pixel = rng.uniform(0.0, SIZE, 2)
    distance = radius * np.exp(rng.uniform(np.log(NEAREST), np.log(FARTHEST)))
    return Rotation.random(random_state=rng).as_matrix(), distance * ray / np.linalg.norm(ray)


def hidden(rng: np.random.Generator, pixels: Floats, seen: np.ndarray) -> np.ndarray:
    """Points that are hidden together: those beyond an edge, or all but a window about any three of them."""
    out = np.zeros(len(seen), np.bool_)
    chance, places = rng.random(), np.flatnonzero(seen)
    if chance < HIDDEN and len(places):
        angle = rng.integers(8) * np.pi / 4
        along = pixels @ (np.cos(angle), np.sin(angle))
        out = along >= along[rng.choice(places)] - 1e-9
    elif chance < 2.0 * HIDDEN and len(places) >= 3:
        three = pixels[rng.choice(places, 3, replace=False)]
        middle = np.linalg.solve(2.0 * (three[1:] - three[0]), (three[1:] ** 2 - three[0] ** 2).sum(axis=1))
        reach = np.linalg.norm(three[0] - middle)
        out = np.linalg.norm(pixels - middle, axis=1) > reach + 1e-6
    return out


def clutter_count(rng: np.random.Generator) -> int:
    """Number of clutter points under Jeffreys' prior of their rate, up to `MOST`."""
    counts = np.arange(MOST + 1)
    weights = np.exp(gammaln(counts + 0.5) - gammaln(counts + 1.0))
    return int(rng.choice(counts, p=weights / weights.sum()))


def drawn(seed: int, kind: str) -> Scene | None:
    """A scene of the model: "P3P", "UP2P", "bodies" or "rig", with "normals" or without."""
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    facing, several, turns = "normals" in kind, 2 if "bodies" in kind else 1, "UP2P" in kind
    views = [(rm.Camera(FOCAL, FOCAL, SIZE / 2, SIZE / 2, size=(SIZE, SIZE)), np.eye(3), np.zeros(3))]
    if "rig" in kind:
        turn = Rotation.from_rotvec((0.0, rng.uniform(-0.3, 0.3), 0.0)).as_matrix()
        views.append((views[0][0], turn, np.array([rng.uniform(-4.0, 4.0), 0.0, 0.0])))
    bodies = [body(rng) for _ in range(several)]
    sigma = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))
    noise = sigma * np.sqrt(1.0 / rng.gamma(10.0, 0.1))
    truths = [[set() for _ in range(len(views) * len(points))] for points, _ in bodies]
    poses = [place(rng, points) for points, _ in bodies]
    rates = [rng.beta(9.0, 1.0) if facing else rng.uniform() for _ in bodies]
    present = rng.random(several) < PRESENT
    rows: list[tuple[float, ...]] = []
    owners: list[tuple[int, int] | None] = []
    for k, (camera, turn, shift) in enumerate(views):
        for b, (points, normals) in enumerate(bodies):
            R, t = poses[b]
            places = (points @ R.T + t) @ turn.T + shift
            pixels = camera.project(places)
            seen = (places[:, 2] > 0.0) & (pixels > 0.0).all(axis=1) & (pixels < SIZE).all(axis=1)
            if facing:
                cosine = -((normals @ R.T @ turn.T) * places).sum(axis=1) / np.linalg.norm(places, axis=1)
                seen &= rng.random(len(points)) < 1.0 / (1.0 + np.exp(-SLOPE * (cosine - np.cos(VIEW)) / EDGE))
            seen &= ~hidden(rng, pixels, seen)
            seen &= (rng.random(len(points)) < rates[b]) & present[b]
            for i in np.flatnonzero(seen).tolist():
                rows.append((*(pixels[i] + noise * rng.normal(size=2)), k))
                owners.append((b, k * len(points) + i))
        count = clutter_count(rng)
        rows += [(*rng.uniform(0.0, SIZE, 2), k) for _ in range(count)]
        owners += [None] * count
    target = np.array(rows).reshape(-1, 3)
    if len(target) < 4 or np.bincount(target[:, 2].astype(int)).max() > MOST:
        return None
    order = rng.permutation(len(target))
    for at, j in enumerate(order.tolist()):
        if (owner := owners[j]) is not None:
            truths[owner[0]][owner[1]].add(at)
    camera = rm.Rig(views, sizes=[(SIZE, SIZE)] * 2) if len(views) > 1 else views[0][0]
    problem: rm.Problem = adversary.tilted_vertical(rng, camera, poses[0][0]) if turns else rm.P3P(camera)
    target = target[order] if len(views) > 1 else target[order, :2]
    given = {"source": np.concatenate([points for points, _ in bodies]), "target": target, "problem": problem}
    given |= {"noise": sigma, "seed": seed}
    if facing:
        given |= {"normals": np.concatenate([normals for _, normals in bodies]), "view_angle": VIEW}
    if several > 1:
        given["bodies"] = np.repeat(np.arange(several), [len(points) for points, _ in bodies])
    return Scene(kind.replace(" normals", ""), given, truths)


def against(seed: int, rigs: bool) -> Scene | None:
    """A scene of `adversary.py`."""
    made = adversary_rigs.drawn(seed) if rigs else adversary.drawn(seed)
    if made.kind[1] == "a stretched copy":
        return None
    upright = isinstance(made.arguments["problem"], rm.UP2P)
    geometry = "rig" if rigs else "bodies" if "bodies" in made.arguments else "UP2P" if upright else "P3P"
    return Scene(geometry, made.arguments, made.truths)


def of_truth(geometry: str, given: dict[str, Any], truth: Any, seed: int) -> Scene:
    """A scene with a detection, or none, of each point."""
    return Scene(geometry, {**given, "seed": seed}, [[{int(j)} if j >= 0 else set() for j in truth]])


def of_accuracy(seed: int, kind: str) -> Scene:
    """A scene of `accuracy.py`."""
    upright = "UP2P" in kind
    if "plain" in kind:
        made = plain(seed, up2p_scene) if upright else plain(seed)
    else:
        made = symmetric(seed, "axis" if upright or "axis" in kind else "centre", upright)
    given = {"source": made.source, "target": made.target, "problem": made.problem, "noise": made.noise}
    return of_truth("UP2P" if upright else "P3P", given, made.truth, seed)


def makers() -> dict[str, Callable[[int], Any]]:
    """What draws the scene of a seed, for each family."""
    found: dict[str, Callable[[int], Any]] = {}
    for kind in ("P3P", "P3P normals", "UP2P", "UP2P normals", "bodies", "bodies normals", "rig", "rig normals"):
        found[f"drawn {kind}"] = lambda seed, kind=kind: drawn(seed, kind)
    found["against"] = lambda seed: against(seed, False)
    found["against rig"] = lambda seed: against(seed, True)
    for kind in ("plain P3P", "plain UP2P", "twins P3P centre", "twins P3P axis", "twins UP2P"):
        found[kind] = lambda seed, kind=kind: of_accuracy(seed, kind)
    scenes = scenes_of("constellations", None)
    if scenes is not None:
        for name in ("sim-5-0", "sim-15-20", "sim-5-0-near", "d6-5-0", "d6-15-0", "d10-15-0"):
            found[name] = lambda seed, name=name: of_truth("P3P", *constellation(name, seed, scenes), seed)
    if (xr := scenes_of("xr", None)) is not None:
        for name in ("few-4-4-LR", "few-4-6-LR", "few-5-8-LR", "few-4-6-R", "few-4-6-L"):
            found[name] = lambda seed, name=name: few_leds(xr, name, seed, None)
    return found


def outcomes(family: str, seed: int, make: Callable[[int], Any]) -> list[Outcome]:
    """What came of each body of a scene; nothing if it has too few detections."""
    made = make(seed)
    if made is None:
        return []
    if isinstance(made, dict):
        pairs = [(match, [{int(j)} if j >= 0 else set() for j in truth]) for match, truth in made.values()]
        return [judged(family, "bodies" if len(pairs) > 1 else "P3P", seed, *pair) for pair in pairs]
    try:
        match = rm.match(**made.arguments, max_seconds=10.0)
    except rm.InputError:
        return []
    bodies = [match] if match.bodies is None else list(match.bodies.values())
    return [judged(family, made.geometry, seed, *pair) for pair in zip(bodies, made.truths, strict=True)]


def judged(family: str, geometry: str, seed: int, match: rm.Match, truth: list[set[int]]) -> Outcome:
    """What was told of a body, and whether it was so."""
    of_rig = match.sightings is not None
    assignment = (match.sightings.assignment if of_rig else match.assignment).ravel()
    confidence = match.finding.every_confidence if of_rig else match.confidence  # of a rig, of each sighting
    if confidence is None:
        confidence = np.full(len(assignment), np.nan)
    right = [(j in own) if j >= 0 else not own for j, own in zip(assignment.tolist(), truth, strict=True)]
    matched = assignment >= 0
    held = all(good for good, used in zip(right, matched, strict=True) if used or not match)
    told = match.probability if match.probability is not None and matched.any() else np.nan
    points = " ".join(
        f"{c:.5f}/{int(used)}/{int(good)}" for c, used, good in zip(confidence, matched, right, strict=True)
    )
    return Outcome(family, geometry, seed, match.status.name.lower(), float(told), int(held), points)


def print_tables(found: list[Outcome]) -> None:
    """The bins of each kind of number, over all and of each geometry."""
    tables: dict[tuple[str, str], Table] = defaultdict(Table)
    for scene, group in enumerate(itertools.groupby(found, lambda one: (one.family, one.seed))):
        for one in group[1]:
            for name in ("all", one.geometry, f"family {one.family}"):
                if one.probability == one.probability:
                    add(tables[name, KINDS[0]], one.probability, bool(one.held), scene)
                for point in one.points.split():
                    told, used, right = point.split("/")
                    if told == "nan":
                        continue
                    add(tables[name, KINDS[1] if used == "1" else KINDS[2]], float(told), right == "1", scene)
    for (name, kind), table in sorted(tables.items(), key=lambda one: (one[0][1], one[0][0])):
        print(f"\n**{kind}, {name}**\n")
        head("from", "number", "scenes", "told", "right", "95 % interval", "holds")
        for cells in table.rows():
            row(*cells)


def add(table: Table, told: float, held: bool, scene: int) -> None:
    """Add one number."""
    table.told.append(told)
    table.held.append(held)
    table.scene.append(scene)


def main() -> None:
    """Match the scenes, print the tables and what was trusted."""
    ask = parser(__doc__, scenes=100, first_seed=1000)
    ask.add_argument("--families", nargs="+", help="beginnings of their names; all if not given")
    ask.add_argument("--csv", type=Path, help="file to which each body is appended")
    given = ask.parse_args()
    found: list[Outcome] = []
    head("family", "bodies", "trusted and right", "trusted and wrong", "seeds of wrong")
    for family, make in makers().items():
        if given.families and not any(family.startswith(name) for name in given.families):
            continue
        own = [
            one
            for seed in range(given.first_seed, given.first_seed + given.scenes)
            for one in outcomes(family, seed, make)
        ]
        trusted = [one for one in own if one.status == "matched"]
        wrong = [one.seed for one in trusted if not one.held]
        row(family, len(own), len(trusted) - len(wrong), len(wrong), " ".join(map(str, wrong)))
        append_csv(given.csv, own)
        found += own
    print_tables(found)


if __name__ == "__main__":
    main()
