"""Near symmetries of bodies, against all triples laid onto all others."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.model.bit_rows import choose_bits, clear_bits, pack_words
from rootmatch.model.near_symmetries import (
    ANGLE,
    APART,
    DISTINCT,
    FACING,
    LAW,
    MAX_POINTS,
    MAXIMUM,
    TOLERANCE,
    find_symmetries,
)

Floats = NDArray[np.float64]


def images(source: Floats, normals: Floats | None, R: Floats, t: Floats) -> dict[int, int]:
    """The nearest point to each after a motion, where that is near and faces alike (oppositely: after a reflection)."""
    off = cdist(source @ R.T + t, source)
    within = np.minimum(tolerance(source), DISTINCT * neighbours(source))
    found = {}
    for i, row in enumerate(off):
        near = [j for j in np.argsort(row) if row[j] < within[j]]
        if normals is not None:
            near = [j for j in near if np.linalg.det(R) * (R @ normals[i]) @ normals[j] >= FACING]
        if near:
            found[i] = int(near[0])
    return found


def tolerance(source: Floats) -> float:
    """Distance up to which points are the same."""
    return float(min(TOLERANCE * np.sqrt(source.var(axis=0).sum()), DISTINCT * np.median(neighbours(source))))


def neighbours(source: Floats) -> Floats:
    """Distance (n,) of each point to the nearest other one."""
    return np.asarray(np.sort(cdist(source, source), axis=1)[:, 1])


def all_symmetries(source: Floats, normals: Floats | None = None, mirrored: bool = False) -> list[tuple[int, Floats]]:
    """Mapped points, `LAW` at least, and rotation, or reflection, of every near symmetry, those that map most first."""
    hand = np.diag([1.0, 1.0, -1.0 if mirrored else 1.0])
    n, distance = len(source), cdist(source, source)
    near, middle = tolerance(source), source.mean(axis=0)
    onto = np.array(list(itertools.permutations(range(n), 3)))
    found: list[tuple[int, Floats]] = []
    places: list[Floats] = []
    maps: list[dict[int, int]] = []
    for base in itertools.combinations(range(n), 3):
        pairs = ((0, 1), (0, 2), (1, 2))
        off = [abs(distance[onto[:, k], onto[:, m]] - distance[base[k], base[m]]) for k, m in pairs]
        for target in onto[np.max(off, axis=0) < near]:
            pairs_of = dict(zip(base, target.tolist(), strict=True))
            if any(pairs_of.items() <= one.items() for one in maps):
                continue
            for _ in range(3):
                own, image = list(pairs_of), list(pairs_of.values())
                first, second = source[own].mean(axis=0), source[image].mean(axis=0)
                turn, _ = Rotation.align_vectors(source[image] - second, (source[own] - first) @ hand)
                R = turn.as_matrix() @ hand
                pairs_of = images(source, normals, R, second - R @ first)
                if len(pairs_of) < LAW:
                    break
            place = R @ (middle - first) + second
            same = any(
                Rotation.from_matrix(R @ other.T).magnitude() < ANGLE and np.linalg.norm(place - there) < APART * near
                for (_, other), there in zip(found, places, strict=True)
            )
            # next to no motion is none, and what is flat is its own reflection
            moved = 4 * sum(i != j for i, j in pairs_of.items()) > len(pairs_of)
            if len(pairs_of) >= max(LAW, n / 4) and moved and not same:
                found.append((len(pairs_of), R))
                places.append(place)
                maps.append(pairs_of)
    return sorted(found, key=lambda one: -one[0])


def half_turn(seed: int, off: float) -> Floats:
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (4, 3))
    rest = np.random.default_rng(seed + 1).uniform(-1.0, 1.0, (2, 3))
    return np.concatenate([points, points * [-1.0, -1.0, 1.0], rest]) + off * rest[:1]


def mirror_image(seed: int, off: float) -> Floats:
    body = half_turn(seed, 0.0)
    body[4:8] = body[:4] * [-1.0, 1.0, 1.0]
    return body + off


def bent(seed: int, off: float) -> Floats:
    body = half_turn(seed, 0.0)
    body[:4] += off * np.random.default_rng(seed).normal(size=(4, 3))
    return body


CUBE = np.array(list(itertools.product([-1.0, 1.0], repeat=3)))
HEXAGON = np.array([[np.cos(angle), np.sin(angle), 0.0] for angle in np.arange(6) * np.pi / 3.0])
NEARLY_IN_LINE = np.column_stack([np.arange(7.0) ** 1.5, 0.01 * np.arange(7.0) ** 2, 0.02 * np.sin(np.arange(7.0))])
BODIES = {
    "random": np.random.default_rng(3).uniform(-1.0, 1.0, (10, 3)),
    "half turn": half_turn(5, 0.0),
    "mirror": mirror_image(5, 0.0),
    "mirror, moved": mirror_image(6, 3.0) @ Rotation.from_rotvec([0.4, 0.2, -0.7]).as_matrix(),
    "moved": half_turn(6, 3.0),
    "nearly": bent(7, 0.002),
    "hardly": bent(8, 0.05),
    "brick": CUBE * [1.0, 1.0, 1.3],
    "hexagon": HEXAGON,
    "nearly in line": NEARLY_IN_LINE,
}


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("name", list(BODIES))
def test_those_of_all_triples_are_found(name: str, mirrored: bool) -> None:
    source = BODIES[name]
    expected = all_symmetries(source, mirrored=mirrored)
    found = [one for one in find_symmetries(source, None, mirrored) if one.mapped_count >= LAW]
    assert [one.mapped_count for one in found] == [count for count, _ in expected][:MAXIMUM]
    for one in found:
        alike = [Rotation.from_matrix(one.rotation @ R.T).magnitude() < 0.02 for _, R in expected]
        assert sum(alike) == 1
        own = np.flatnonzero(one.image >= 0)
        assert images(source, None, one.rotation, one.shift) == dict(zip(own, one.image[own], strict=True))
        assert np.linalg.det(one.rotation) == pytest.approx(-1.0 if mirrored else 1.0)
    turned = {"half turn": [8], "moved": [8], "nearly": [8], "hexagon": [6] * 11, "brick": [8] * 7}
    reflected = {"mirror": [8], "mirror, moved": [8], "hexagon": [6] * 11, "brick": [8] * 8}
    assert [one.mapped_count for one in found] == (reflected if mirrored else turned).get(name, [])


def ring(count: int, *heights: float) -> Floats:
    """Points about an axis, and some on it."""
    angle = 2.0 * np.pi / count * np.arange(count)
    axis = [(0.0, 0.0, height) for height in heights]
    return np.array([*np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)]), *axis])


TETRAHEDRON = CUBE[[0, 3, 5, 6]]
OBLONG = ring(4) @ np.diag([1.0, 0.6, 1.0])
FEW = {  # and the number of motions that map all of its points
    "square": (ring(4), 7),
    "rhombus": (OBLONG, 3),
    "pentagon": (ring(5), 9),
    "cross": (ring(4, 0.0), 7),
    "star": (ring(3, 0.0), 5),
    "tetrahedron": (TETRAHEDRON, 11),
    "low tetrahedron": (ring(3, 0.8), 2),
    "bipyramid": (ring(3, 1.2, -1.2), 5),
    "pyramid": (ring(4, 0.9), 3),
    "half turn": (np.array([[1, 0.2, 0.3], [-1, -0.2, 0.3], [0.4, -0.7, 0], [-0.4, 0.7, 0], [0, 0, 1]], float), 1),
    "irregular": (np.random.default_rng(3).uniform(-1.0, 1.0, (5, 3)), 0),
}


@pytest.mark.parametrize("name", list(FEW))
def test_few_points_are_as_symmetric_as_they_are(name: str) -> None:
    source, count = FEW[name]
    found = find_symmetries(source, None)
    assert [one.mapped_count for one in found[:count]] == [len(source)] * count
    assert all(one.mapped_count < len(source) for one in found[count:])


@pytest.mark.parametrize("name", [name for name, (_, count) in FEW.items() if count])
def test_a_rig_cannot_tell_which_way_round_few_points_are(name: str) -> None:
    """No search need have met the other ways round: each camera shows all points."""
    source, camera, shift = 50.0 * FEW[name][0], rm.Camera(900.0, 900.0, 640.0, 480.0), np.array([-150.0, 0.0, 0.0])
    rig = rm.Rig([(camera, np.eye(3), np.zeros(3)), (camera, np.eye(3), shift)])
    for seed in range(3):
        rng = np.random.default_rng(seed)
        placed = source @ Rotation.random(random_state=rng).as_matrix().T + (20.0, -10.0, 700.0)
        pixels = np.concatenate([camera.project(placed), camera.project(placed + shift)])
        target = pixels + rng.normal(0.0, 0.3, pixels.shape), np.repeat([0, 1], len(source))
        assert not rm.match(source, target, rm.P3P(rig), noise=0.3)


def test_a_reflection_reverses_what_faces_the_camera() -> None:
    source = mirror_image(5, 0.0)
    normals = np.tile([0.0, 0.0, 1.0], (len(source), 1))
    assert find_symmetries(source, normals, mirrored=True) == ()
    normals[4:8] *= -1.0
    (one,) = find_symmetries(source, normals, mirrored=True)
    assert one.image.tolist() == [4, 5, 6, 7, 0, 1, 2, 3, -1, -1]
    assert len(all_symmetries(source, normals, mirrored=True)) == 1


def test_normals_forbid_a_symmetry() -> None:
    source = half_turn(5, 0.0)
    normals = source / np.linalg.norm(source, axis=1, keepdims=True)
    (one,) = find_symmetries(source, normals)
    assert one.mapped_count == 8
    normals[4] *= -1.0
    (one,) = find_symmetries(source, normals)
    assert one.image.tolist() == [-1, 5, 6, 7, -1, 1, 2, 3, -1, -1]
    assert len(all_symmetries(source, normals)) == 1
    normals[5:7] *= -1.0
    assert find_symmetries(source, normals) == ()
    normals[4:7] = 0.0  # unknown: facing anywhere
    assert find_symmetries(source, normals)[0].mapped_count == 8


def test_a_quarter_of_many_points_suffices() -> None:
    rng = np.random.default_rng(2)
    few = rng.uniform(-1.0, 1.0, (8, 3))
    quarter = Rotation.from_rotvec([0.0, 0.0, 0.5 * np.pi]).as_matrix()
    source = np.concatenate([few, few @ quarter.T, rng.uniform(-1.0, 1.0, (16, 3))])
    found = find_symmetries(source, None)
    assert [one.mapped_count for one in found] == [8, 8]  # there and back
    angles = [Rotation.from_matrix(one.rotation).as_rotvec()[2] for one in found]
    assert sorted(angles) == pytest.approx([-0.5 * np.pi, 0.5 * np.pi])


def steps_of(source: Floats, each: int) -> list[tuple[int, float]]:
    """Mapped points, and by how many steps of so many points, of the symmetries that displace all by the same."""
    found = []
    for one in find_symmetries(source, None):
        own = np.flatnonzero(one.image >= 0)
        if np.ptp(one.image[own] - own) == 0:
            found.append((one.mapped_count, (one.image[own] - own)[0] / each))
    return found


STEP = np.random.default_rng(12).uniform(0.0, 1.0, (3, 3)) * [0.5, 1.0, 1.0]


@pytest.mark.parametrize("turn", [0.0, 0.05, 0.4])
def test_what_repeats_itself_is_displaced_along_itself(turn: float) -> None:
    """Stairs, straight, hardly bent and winding: by one step up and down, by two, and so on."""
    along = [Rotation.from_rotvec([0.0, 0.0, k * turn]).as_matrix() for k in range(8)]
    places = np.column_stack([np.zeros(8), np.full(8, 5.0), 0.3 * np.arange(8)])  # about an axis beside it
    if turn == 0.0:
        places[:, 0] = 0.6 * np.arange(8)
    source = np.concatenate([(STEP + place) @ R.T for place, R in zip(places, along, strict=True)])
    assert {(21, 1), (21, -1), (18, 2), (18, -2)} <= set(steps_of(source, 3))


def test_a_thin_body_has_neighbours_that_are_told_apart() -> None:
    tower = np.array([[0.0, -5.0, 20.0], [0.0, 4.0, 21.0], [0.0, -7.0, 26.0], [0.0, 3.0, 31.0]])
    source = np.concatenate([tower + np.array([300.0 * k, 0.0, 0.0]) for k in range(8)])
    assert {(28, 1), (28, -1)} <= set(steps_of(source, 4))


def test_points_that_are_near_each_other_are_told_apart_where_most_are_not() -> None:
    """Lights of an approach, a metre apart, before those of a runway: the half turn is about its middle line."""
    rng = np.random.default_rng(4)
    edge = [(60.0 * x, 22.5 * y, 0.0) for x in range(20) for y in (-1, 1)]
    approach = [(-30.0 * x, y, 0.0) for x in range(1, 14) for y in (-2, -1, 0, 1, 2)]
    source = np.array(edge + approach) + rng.normal(0.0, 0.03, (105, 3))
    first = find_symmetries(source, None)[0]
    assert first.mapped_count >= 103
    assert abs(first.shift[1]) < 0.05
    assert Rotation.from_matrix(first.rotation).magnitude() == pytest.approx(np.pi, abs=0.01)


def test_what_is_never_symmetric_and_that_each_body_is_asked_once() -> None:
    assert find_symmetries(CUBE[:3], None) == ()
    assert find_symmetries(np.tile(np.arange(MAX_POINTS + 1.0)[:, None], 3), None) == ()
    assert find_symmetries(np.arange(8.0)[:, None] * [1.0, 2.0, 3.0], None) == ()  # in line: no triple has a plane
    assert find_symmetries(CUBE, None) is find_symmetries(CUBE.copy(), None)
    with pytest.raises(ValueError, match="read-only"):
        find_symmetries(CUBE, None)[0].image[0] = 0


def test_some_true_values_of_packed_rows_are_those_of_a_list_of_all() -> None:
    rng = np.random.default_rng(3)
    mask = rng.random((40, 100)) < 0.05
    words = pack_words(mask)
    row, column = np.nonzero(mask)
    assert np.array_equal(choose_bits(words, 1_000), (row, column))
    chosen = np.column_stack(choose_bits(words, 30))
    assert len(np.unique(chosen, axis=0)) == 30
    assert mask[tuple(chosen.T)].all()
    first = np.unique(row, return_index=True)[1]
    clear_bits(words, row[first], column[first])
    assert np.array_equal(choose_bits(words, 1_000), (np.delete(row, first), np.delete(column, first)))
    assert len(choose_bits(pack_words(mask[:0]), 5)[0]) == 0
