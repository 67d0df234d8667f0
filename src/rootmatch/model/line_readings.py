"""Poses of a body that shows only points on a line: seen from either end, and turned about the line.

Four points on a line and their images have the same cross-ratio from either end, so both readings fit. No minimal set
of three determines a pose there, so a search meets one of them by chance, or matches points beside the line with it.
"""

from __future__ import annotations

import math
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import rotation_from_vector
from rootmatch.arrays import Bools, Floats, Integers, cache_by_values
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.modes import Modes
from rootmatch.model.prediction import Settled, collect_proposals, settle_assignment
from rootmatch.model.proposals import Proposals, empty_proposals, join_proposals
from rootmatch.problems.pose_fit.reference_point import STRAIGHT

FLAT = 0.02
"""Width of matched points over their length up to which they are on a line: of a wand of 20 cm whose line is bent by
.5 mm some readings are still lost, by 4 mm none. A round value."""
NARROW = 0.15
"""That of points that hardly tell how a body is turned about their line. A round value."""
TURNS = 8
"""Poses about the line. A round value."""
MINIMUM = 3
"""Points on a line that determine it."""
FOUR, MAX_POINTS = 4, 64
"""Points on a line of a body that are looked for beside those that were matched, as three are often nearly on one; and
the largest body in which any are. Round values."""
MAXIMUM, KEPT = 40, 4
"""Choices of so many points and detections of a line that are tried, and readings kept, those that fit best. Round
values."""


def propose_line_readings(model: DetectionModel, assignments: Integers) -> Proposals:
    """Poses in which points on a line have the detections of assignments (K, n) of one image, if these are on one.

    From either end, and turned about the line.
    """
    parts = [empty_proposals(model.shape[0])]
    if len(model.images) > 1 or not len(assignments):
        return parts[0]  # several cameras tell the depth of each end
    for row in assignments[_is_on_line(model, assignments)]:
        for reading in _read_line(model, row):
            (used,) = np.nonzero(reading >= 0)
            origin, axis = _fit_line(model.points[used])
            seen = _fit_camera_lines(model.rays[reading[used]][None], ((model.points[used] - origin) @ axis)[None])
            if seen.in_front[0]:
                parts.append(_poses_about_line(model, reading, (origin, axis), (seen.place[0], seen.direction[0])))
    return join_proposals(parts)


def turn_about_lines(model: DetectionModel, modes: Modes) -> Proposals:
    """Turned about the line on which all points with matches are, what modes lead to by what is seen beside the line.

    A fit stays at the turn where it begins, or goes to the predicted one, and does not ask what another would show.
    """
    known: dict[bytes, Settled] = {}
    n = len(model.points) // max(len(model.images), 1)
    for row, R, position, covariance in zip(*modes[:3], modes.covariance, strict=True):
        if not is_turn_loose(covariance):
            continue
        (used,) = (row >= 0).reshape(-1, n).any(axis=0).nonzero()
        line = _find_line(model.points[:n], used) if MINIMUM <= len(used) < n else None
        if line is None or not np.isfinite(covariance).all():
            continue
        place, direction = position + R @ (line[0] - model.centre), R @ line[1]
        turned = _poses_about_line(model, row, line, (place, direction))
        for rotation, there in zip(turned.rotation, turned.position, strict=True):
            along = np.concatenate([direction, np.cross(direction, there - place)])
            wide = covariance + (np.pi / TURNS) ** 2 / 3.0 * np.outer(along, along)  # up to half the way to the next
            settle_assignment(model, (rotation[None], there[None]), wide, known=known)
    found = collect_proposals(list(known.values()))
    return empty_proposals(model.shape[0]) if found is None else found


def is_turn_loose(covariance: Floats) -> bool:
    """Whether it is hardly known how a body is turned, by the covariance (6, 6) of its pose."""
    return bool(covariance[0, 0] + covariance[1, 1] + covariance[2, 2] > STRAIGHT**2)


@cache_by_values(256)
def _find_line(points: Floats, used: Integers) -> tuple[Floats, Floats] | None:
    """Mean and direction of some of the points (n, 3), if these are on a line."""
    return _fit_line(points[used]) if _is_collinear(points[used], NARROW) else None


def _is_on_line(model: DetectionModel, assignments: Integers) -> Bools:
    """Whether the detections of assignments (K, n), three or more, are on a line: their rays are in a plane."""
    used = assignments >= 0
    rays = np.where(used[..., None], model.rays[np.maximum(assignments, 0)], 0.0)
    across, along, _ = np.linalg.eigvalsh(np.nan_to_num(rays.swapaxes(1, 2) @ rays)).T
    return np.asarray((used.sum(axis=1) >= MINIMUM) & (across <= FLAT**2 * along))


def _read_line(model: DetectionModel, row: Integers) -> list[Integers]:
    """Assignments of the detections of another (n,), which are on a line, to points on one."""
    (used,) = np.nonzero(row >= 0)
    if _is_collinear(model.points[used]):
        return [row, _reverse_reading(model, row)]
    detections, found = row[used], list[tuple[float, Integers]]()
    rays = model.rays[detections]
    in_order = detections[np.argsort(rays @ np.linalg.svd(rays)[2][1])]
    for points, images in _list_line_choices(model.points, len(detections)):
        places, seen = model.points[points], in_order[images]
        own = places - places.mean(axis=1, keepdims=True)
        axis = np.linalg.eigh(own.swapaxes(1, 2) @ own)[1][:, :, 2:]
        lines = _fit_camera_lines(model.rays[seen], (own @ axis)[..., 0])
        for k in np.flatnonzero(lines.in_front)[np.argsort(lines.misfit[lines.in_front], kind="stable")][:KEPT]:
            reading = np.full_like(row, -1)
            reading[points[k]] = seen[k]
            found.append((float(lines.misfit[k]), reading))
    return [one for _, one in sorted(found, key=lambda each: each[0])[:KEPT]]


@cache_by_values(64)
def _list_line_choices(points: Floats, count: int) -> list[tuple[Integers, Integers]]:
    """Points on lines of a body (n, 3) and images of these, (B, k) each, as places among so many in order on a line.

    From either end. At least `FOUR` of them: any three on a line look like three others.
    """
    of_size: dict[int, tuple[list[tuple[int, ...]], list[tuple[int, ...]]]] = {}
    for line in find_lines(points):
        size = min(len(line), count)
        if size < FOUR or math.comb(len(line), size) * math.comb(count, size) > MAXIMUM:
            continue
        own, images = of_size.setdefault(size, ([], []))
        for chosen, seen in product(combinations(line.tolist(), size), combinations(range(count), size)):
            own += [chosen, chosen]
            images += [seen, seen[::-1]]
    return [(np.array(own), np.array(images)) for own, images in of_size.values()]


def _reverse_reading(model: DetectionModel, row: Integers) -> Integers:
    """An assignment (n,) of points on a line, read from the other end."""
    (used,) = np.nonzero(row >= 0)
    order = used[np.argsort((model.points[used] - model.points[used[0]]) @ _fit_line(model.points[used])[1])]
    other = row.copy()
    other[order] = row[order[::-1]]
    return other


def _fit_line(points: Floats) -> tuple[Floats, Floats]:
    """Mean (3,) and direction (3,) of points (k, 3)."""
    origin = points.mean(axis=0)
    return origin, np.linalg.svd(points - origin, full_matrices=False)[2][0]


def _is_collinear(points: Floats, width: float = FLAT) -> bool:
    """Whether points (k, 3) hardly extend across the direction in which they extend most."""
    lengths = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(lengths[1] <= width * lengths[0])


@cache_by_values(64)
def find_lines(points: Floats) -> list[Integers]:
    """The sets of `FOUR` points or more of a body (n, 3) that are on a line, in their order on it."""
    if len(points) > MAX_POINTS or len(points) < FOUR:
        return []
    first, second = np.triu_indices(len(points), 1)
    across = points[second] - points[first]
    length = np.linalg.norm(across, axis=1)
    axis, away = across / length[:, None], points - points[first][:, None]
    along = (away @ axis[..., None])[..., 0]
    off = np.linalg.norm(away - along[..., None] * axis[:, None], axis=2)
    near = off <= FLAT * np.maximum(np.ptp(along, axis=1), length)[:, None]
    found = dict[bytes, Integers]()
    for pair in np.flatnonzero(near.sum(axis=1) >= FOUR):
        (own,) = np.nonzero(near[pair])
        if _is_collinear(points[own]):
            own = own[np.argsort(along[pair, own])]
            own = own if own[0] < own[-1] else own[::-1]
            found[own.tobytes()] = own
    return list(found.values())


class _Lines(NamedTuple):
    """Lines in the camera frame."""

    place: Floats
    """(B, 3) of the origins of their points."""
    direction: Floats
    """(B, 3)."""
    in_front: Bools
    """(B,) whether all points are in front of the camera."""
    misfit: Floats
    """(B,)."""


def _fit_camera_lines(rays: Floats, along: Floats) -> _Lines:
    """Lines from rays (B, k, 3) to points at known places (B, k) on them.

    The least squares of r × (c + s d) over unit vectors (c, d), brought to the length of d.
    """
    cross = np.cross(rays[..., None, :], np.eye(3)).swapaxes(-1, -2)
    rows = np.concatenate([cross, along[..., None, None] * cross], axis=-1).reshape(len(rays), -1, 6)
    squares, vectors = np.linalg.eigh(rows.swapaxes(1, 2) @ rows)
    place, direction = vectors[:, :3, 0], vectors[:, 3:, 0]
    depths = ((place[:, None] + along[..., None] * direction[:, None]) * rays).sum(axis=2)
    size = np.linalg.norm(direction, axis=1)
    in_front = (size > 0.0) & (np.abs(np.sign(depths).sum(axis=1)) == depths.shape[1])  # all ahead, or all behind
    size = np.where(depths[:, 0] < 0.0, -1.0, 1.0) * np.maximum(size, np.finfo(float).tiny)
    misfit = np.sqrt(np.maximum(squares[:, 0], 0.0))
    return _Lines(place / size[:, None], direction / size[:, None], in_front, misfit)


def _poses_about_line(
    model: DetectionModel, reading: Integers, line: tuple[Floats, Floats], found: tuple[Floats, Floats]
) -> Proposals:
    """Poses of a body with a line of its own (origin, direction) on one in the camera frame, turned about that."""
    (origin, axis), (place, direction) = line, found
    turn = np.cross(axis, direction)
    sine, cosine = float(np.linalg.norm(turn)), float(axis @ direction)
    if sine > 1e-9:
        turn *= np.arctan2(sine, cosine) / sine
    elif cosine < 0.0:
        turn = np.pi * np.linalg.svd(axis[None])[2][1]  # half a turn about anything across
    onto = rotation_from_vector(turn[None])[0]
    angles = 2.0 * np.pi * np.arange(TURNS) / TURNS
    rotation = rotation_from_vector(angles[:, None] * direction) @ onto
    position = place + rotation @ (model.centre - origin)
    return Proposals(np.tile(reading, (TURNS, 1)), rotation, position)
