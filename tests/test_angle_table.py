"""The table of angles about a known place against all pairs of matches, and what a star camera gains by it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain import angle_table
from rootmatch.explain.angle_table import Agreeing, Directions, search_angle_table
from rootmatch.explain.known_pose import match_known
from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.limits import GATE

CAMERA = rm.Camera(2200.0, 2200.0, 640.0, 480.0)
SIGMA = 0.3


class Sky:
    """Stars about a camera, those that it sees, and clutter."""

    def __init__(self, seed: int, stars: int, clutter: int = 2, moved: float = 1e-6, distance: float = 1.0) -> None:
        rng = np.random.default_rng([seed, stars])
        points = rng.normal(size=(stars, 3))
        far = distance * rng.uniform(1.0, 1.0 if distance == 1.0 else 2.0, (stars, 1))
        self.points = points / np.linalg.norm(points, axis=1, keepdims=True) * far
        self.moved = moved
        rotation = Rotation.random(random_state=seed).as_matrix()
        inside = self.points @ rotation.T + moved * rng.normal(size=3)
        pixels = CAMERA.project(inside)
        seen = (inside[:, 2] > 0.0) & (pixels > 0.0).all(axis=1) & (pixels < (1280.0, 960.0)).all(axis=1)
        self.seen = np.flatnonzero(seen & (rng.random(stars) > 0.1))
        pixels = pixels[self.seen] + rng.normal(scale=SIGMA, size=(len(self.seen), 2))
        pixels = np.vstack([pixels, rng.uniform((0, 0), (1280, 960), (clutter, 2))])
        order = rng.permutation(len(pixels))
        self.pixels, self.truth = pixels[order], np.full(stars, -1)
        self.truth[self.seen] = np.argsort(order)[: len(self.seen)]
        self.prior = rm.PosePrior(position=((0.0, 0.0, 0.0), moved))

    def directions(self) -> Directions:
        """Every star may be every detection."""
        i, j = (part.ravel() for part in np.indices((len(self.points), len(self.pixels))))
        own = self.points / np.linalg.norm(self.points, axis=1, keepdims=True)
        variance = np.full(len(i), (SIGMA / 2200.0) ** 2 + self.moved**2)
        return Directions(i, j, CAMERA.bearings(self.pixels)[j], variance, own)

    def task(self) -> MatchingTask:
        return MatchingTask.of(
            rm.P3P(CAMERA), self.points, self.pixels, noise=SIGMA, prior=self.prior, options=MatchOptions()
        )

    def are_true(self, given: Directions, found: Agreeing) -> NDArray[np.bool_]:
        return np.all([self.truth[given.i[k]] == given.j[k] for k in (found.first, found.second)], axis=0)


def skies(count: int, stars: int, **how: float) -> list[Sky]:
    """Those of some skies that show five stars."""
    every = (Sky(seed, stars, **how) for seed in range(200))  # type: ignore[arg-type]
    return [sky for sky in every if len(sky.seen) >= 5][:count]


def pairs_of(found: Agreeing) -> set[tuple[int, int]]:
    """The pairs in any order."""
    return set(map(tuple, np.sort(np.column_stack([found.first, found.second]), axis=1).tolist()))


def all_that_agree(given: Directions) -> set[tuple[int, int]]:
    """By the angle of every pair of matches."""
    found = set()
    for a in range(len(given.i)):
        b = np.arange(a + 1, len(given.i))
        b = b[(given.i[b] != given.i[a]) & (given.j[b] != given.j[a])]
        there = np.arccos(np.clip(given.of_points[given.i[b]] @ given.of_points[given.i[a]], -1.0, 1.0))
        seen = np.arccos(np.clip(given.towards[b] @ given.towards[a], -1.0, 1.0))
        gate = GATE * np.sqrt(given.variance[a] + given.variance[b])
        agrees = (np.abs(seen - there) <= gate) & (there > gate) & (there < np.pi - gate)
        found |= {(a, k) for k in b[agrees].tolist()}
    return found


@pytest.mark.parametrize("seed", range(3))
def test_the_table_has_the_pairs_that_agree_of_all(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(angle_table, "MISSED", -1.0)  # no pair of detections is left out
    monkeypatch.setattr(angle_table, "PARTS", 1)
    sky = skies(3, 80)[seed]
    given = sky.directions()
    found = search_angle_table(given, np.random.default_rng(0), maximum=10**9)
    assert found is not None
    assert len(pairs_of(found)) == len(found.first)
    assert pairs_of(found) == all_that_agree(given)


@pytest.mark.parametrize(("stars", "clutter"), [(500, 2), (500, 40), (1500, 2)])
def test_right_pairs_come_first_and_tell_the_rotation(stars: int, clutter: int) -> None:
    for seed, sky in enumerate(skies(4, stars, clutter=clutter)):
        given = sky.directions()
        found = search_angle_table(given, np.random.default_rng(seed), maximum=20)
        assert found is not None
        right = sky.are_true(given, found)
        assert right[0]
        one = given.towards[found.first]
        turned = (found.rotation @ given.of_points[given.i[found.first]][..., None])[..., 0]
        assert np.abs(np.linalg.norm(np.cross(turned, one), axis=1)).max() < 2e-3
        np.testing.assert_allclose(np.linalg.det(found.rotation), 1.0)


def test_what_tells_too_little_is_not_looked_up() -> None:
    sky = skies(1, 500)[0]
    given, rng = sky.directions(), np.random.default_rng(0)
    assert search_angle_table(given._replace(variance=np.full(len(given.i), 0.03**2)), rng, maximum=20) is None, "vague"
    twice = given._replace(**{name: np.concatenate([getattr(given, name)] * 2) for name in given._fields[:-1]})
    assert search_angle_table(twice, rng, maximum=20) is None, "two directions"
    none = given._replace(**{name: getattr(given, name)[:0] for name in given._fields[:-1]})
    assert search_angle_table(none, rng, maximum=20) is None, "nothing may be matched"
    one = given._replace(**{name: getattr(given, name)[given.j == 0] for name in given._fields[:-1]})
    assert search_angle_table(one, rng, maximum=20) is None, "one detection"


@pytest.mark.parametrize(("stars", "moved", "distance"), [(500, 1e-6, 1.0), (200, 1e-6, 1.0), (300, 0.002, 3.0)])
def test_a_camera_at_a_known_place_among_many_points_needs_no_search(stars: int, moved: float, distance: float) -> None:
    """A search by triples takes seconds here, and finds some of them; points may be near, and the place uncertain."""
    for sky in skies(3, stars, moved=moved, distance=distance):
        found = match_known(sky.task(), None)
        assert found.status is rm.Status.MATCHED
        claimed = found.assignment >= 0
        assert np.array_equal(found.assignment[claimed], sky.truth[claimed])
        assert claimed.sum() >= 0.9 * len(sky.seen)
        assert found.evaluated == 0


def test_masked_stars_are_left_out_and_other_skies_are_not_trusted() -> None:
    for sky in skies(3, 300):
        masked = sky.seen[0]
        candidates = np.ones((300, len(sky.pixels)), np.bool_)
        candidates[masked] = False
        match = rm.match(sky.points, sky.pixels, rm.P3P(CAMERA), noise=SIGMA, prior=sky.prior, candidates=candidates)
        assert match.assignment[masked] == -1
        other = Sky(999, 300)
        task = MatchingTask.of(
            rm.P3P(CAMERA), other.points, sky.pixels, noise=SIGMA, prior=sky.prior, options=MatchOptions()
        )
        assert match_known(task, None).status is rm.Status.UNTRUSTED
