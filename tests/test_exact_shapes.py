"""Bodies that are exactly symmetric, or exact copies of each other, though their points were measured with errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.arrays import Floats, Integers
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import weigh_assignments
from rootmatch.model.exact_shapes import _shape_log_gains, exact_shape_log_gains
from rootmatch.model.exact_symmetry import fit_exact_shape, leave_points_out
from rootmatch.model.mode_search import find_modes
from rootmatch.model.pose_density import Broad
from rootmatch.model.proposals import Proposals

SIZE = (1280, 960)
CAMERA = rm.Camera(1500.0, 1500.0, 640.0, 480.0, size=SIZE)
PIXEL, MODEL = 0.3, 0.5
HALF_TURN = np.array([-1.0, -1.0, 1.0])
STEPS = 2.0 * np.pi * np.arange(8) / 8.0


def ring() -> Floats:
    """Two bolt circles of eight; an eighth of a turn takes each point to the next."""
    circles = [
        np.column_stack([r * np.cos(STEPS + a), r * np.sin(STEPS + a), z + 0.0 * STEPS])
        for r, a, z in ((100.0, 0.0, 0.0), (60.0, 0.3, 30.0))
    ]
    return np.concatenate(circles)


def halves(rng: np.random.Generator) -> Floats:
    """Seven points and the same half a turn on."""
    half = rng.uniform(-100.0, 100.0, (7, 3))
    return np.concatenate([half, half * HALF_TURN])


def image(bodies: list[Floats], rng: np.random.Generator) -> tuple[Floats, list[Integers]]:
    """Detections of bodies of which a fifth of the points are missed, amid clutter, and that of each point or −1."""
    places, truth, start = [], [], 0
    for k, points in enumerate(bodies):
        R = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
        t = np.array([220.0 * (k - 0.5 * (len(bodies) - 1)), rng.normal(0.0, 40.0), rng.uniform(1200.0, 1500.0)])
        seen = np.flatnonzero(rng.random(len(points)) < 0.8)
        places.append(CAMERA.project(points[seen] @ R.T + t))
        truth.append(np.full(len(points), -1))
        truth[-1][seen] = start + np.arange(len(seen))
        start += len(seen)
    places.append(rng.uniform((0.0, 0.0), SIZE, (5, 2)))
    target = np.concatenate(places)
    order = rng.permutation(len(target))
    place = np.append(np.argsort(order), -1)
    return (target + rng.normal(0.0, PIXEL, target.shape))[order], [place[one] for one in truth]


def measured(points: Floats, rng: np.random.Generator) -> Floats:
    return points + rng.normal(0.0, MODEL, points.shape)


@pytest.mark.parametrize(("name", "turns"), [("ring", 8), ("halves", 2)])
def test_errors_of_a_symmetric_body_do_not_tell_which_way_round_it_is(name: str, turns: int) -> None:
    for seed in range(3):
        rng = np.random.default_rng([seed, turns])
        points = ring() if name == "ring" else halves(rng)
        target, _ = image([points], rng)
        match = rm.match(measured(points, rng), target, rm.P3P(CAMERA), noise=PIXEL, source_noise=MODEL)
        assert match.status is rm.Status.AMBIGUOUS
        assert match.probability == pytest.approx(1.0 / turns, abs=0.1)


@pytest.mark.parametrize("displaced", ["all", "one"])
def test_what_is_asymmetric_by_more_than_its_noise_is_trusted(displaced: str) -> None:
    """All points are off by 4 σ on each axis, or one, that is seen, by 15."""
    for seed in range(3):
        rng = np.random.default_rng([seed, 17])
        points = ring()
        if displaced == "all":
            points += rng.normal(0.0, 4.0 * MODEL, points.shape)
        else:
            points[3, 2] += 15.0 * MODEL
        target, (truth,) = image([points], rng)
        match = rm.match(measured(points, rng), target, rm.P3P(CAMERA), noise=PIXEL, source_noise=MODEL)
        if truth[3] < 0 and displaced == "one":
            continue
        assert match.status is rm.Status.MATCHED
        assert ((match.assignment == truth) | (match.assignment < 0)).all()


@pytest.mark.parametrize("displaced", [0.0, 4.0])
def test_which_of_two_copies_is_which_is_not_told_by_errors(displaced: float) -> None:
    for seed in range(4):
        rng = np.random.default_rng([seed, 18])
        first = rng.uniform(-90.0, 90.0, (10, 3))
        bodies = [first, first + displaced * rng.normal(0.0, MODEL, first.shape)]
        target, truth = image(bodies, rng)
        source = np.concatenate([measured(points, rng) for points in bodies])
        match = rm.match(
            source, target, rm.P3P(CAMERA), noise=PIXEL, source_noise=MODEL, bodies=["first"] * 10 + ["second"] * 10
        )
        for body, own in zip(("first", "second"), truth, strict=True):
            assert match.bodies is not None
            found = match.bodies[body]
            if displaced:
                assert found.status is rm.Status.MATCHED
                assert ((found.assignment == own) | (found.assignment < 0)).all()
            else:
                assert found.status is rm.Status.AMBIGUOUS
                assert found.probability == pytest.approx(0.5, abs=0.15)


def test_the_evidence_of_an_exact_shape_is_the_mean_over_such_shapes() -> None:
    """Drawn from all that are exactly symmetric, given what was measured."""
    for seed in range(3):
        rng = np.random.default_rng([seed, 19])
        points, noise = halves(rng), 0.15
        R, t = Rotation.random(random_state=seed).as_matrix(), np.array([20.0, -10.0, 1400.0])
        target = CAMERA.project(points @ R.T + t) + rng.normal(0.0, PIXEL, (14, 2))
        source, covariance = points + rng.normal(0.0, noise, points.shape), np.tile(noise**2 * np.eye(3), (14, 1, 1))
        half = np.roll(np.arange(14), 7)
        shape = fit_exact_shape(source, covariance, [(np.arange(14), half)])
        assert shape is not None
        moved = source + shape.moved  # half a turn takes them onto each other, about an axis that is theirs
        distances = np.linalg.norm(moved[:, None] - moved, axis=2)
        assert np.abs(distances - distances[np.ix_(half, half)]).max() < 0.01 * noise
        model = DetectionModel(
            CAMERA, source, target, np.full(14, PIXEL), source_covariance=covariance, prior=Broad(100.0)
        )
        place = model.centred(R[None], t[None])
        modes = find_modes(model, Proposals(np.arange(14)[None], *place))
        assignments = modes.assignments[:1]
        told = modes.log_odds[0] + _shape_log_gains(model, modes.take(slice(1)), shape)[0]
        values, axes = np.linalg.eigh(shape.covariance)
        draws = []
        for _ in range(600):
            off = axes @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=len(values)))
            exact = dataclasses.replace(model, points=moved + off.reshape(-1, 3), source_covariance=None)
            at = exact.linearise_about(*(one for one in exact.centred(R[None], t[None])))
            draws.append(weigh_assignments(exact, assignments, at).log_odds[0])
        assert told == pytest.approx(np.logaddexp.reduce(draws) - np.log(len(draws)), abs=0.5)


def test_shapes_that_a_point_is_displaced_from_count_by_how_far_it_is() -> None:
    half, motion = np.random.default_rng(20), np.roll(np.arange(14), 7)
    points, covariance = halves(half), np.tile(MODEL**2 * np.eye(3), (14, 1, 1))
    motions = [(np.arange(14), motion)]
    for seed in range(5):
        rng = np.random.default_rng([seed, 21])
        source = measured(points, rng)
        found = []
        for off in (0.0, 12.0 * MODEL):
            now = source + off * (np.arange(14) == 4)[:, None] * [0.0, 1.0, 0.0]
            whole = fit_exact_shape(now, covariance, motions)
            assert whole is not None
            shapes = leave_points_out(now, covariance, motions, whole)
            found.append(max(shapes, key=lambda one: one.log_odds))
        assert np.abs(found[0].moved[4]).max() > 1e-3  # exact as a whole
        assert np.abs(found[1].moved[4]).max() < 1e-9  # but for this point, so that its partner stays as well


def test_nothing_changes_for_points_that_are_exact_or_drawn() -> None:
    rng = np.random.default_rng(22)
    points = halves(rng)
    R, t = Rotation.random(random_state=3).as_matrix(), np.array([20.0, -10.0, 1400.0])
    target = CAMERA.project(points @ R.T + t) + rng.normal(0.0, PIXEL, (14, 2))
    turned = R @ np.diag(HALF_TURN)
    for covariance in (None, np.tile(MODEL**2 * np.eye(3), (14, 1, 1))):
        model = DetectionModel(
            CAMERA, points, target, np.full(14, PIXEL), source_covariance=covariance, prior=Broad(100.0)
        )
        both = [model.centred(one[None], t[None]) for one in (R, turned)]
        proposals = Proposals(
            np.array([np.arange(14), np.roll(np.arange(14), 7)]),
            np.concatenate([one[0] for one in both]),
            np.concatenate([one[1] for one in both]),
        )
        modes = find_modes(model, proposals)
        assert len(modes.log_odds) == 2
        assert exact_shape_log_gains(model, modes) == 0.0
