"""The whole pipeline on the paper's scenes, its options, and its judgement of itself."""

from dataclasses import replace

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.explain.status_advice import general_advice
from rootmatch.hypergraph.enumeration import exhaustive_count
from rootmatch.samplers.limits import LIMITS
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene

SEEDS = range(5000, 5030)
CAMERA = rm.Camera(1000, 1000, 320, 240)


def accuracy(scenes: list[Scene], **options: object) -> float:
    matches = [
        rm.match(scene.source, scene.target, scene.problem, noise=max(scene.noise, 1e-3), **options) for scene in scenes
    ]
    return float(np.mean([scene.accuracy(match.assignment) for scene, match in zip(scenes, matches, strict=True)]))


def test_p3p_at_one_pixel() -> None:
    assert accuracy([p3p_scene(noise=1.0, seed=seed) for seed in SEEDS]) >= 0.98


def test_p3p_with_five_outliers() -> None:
    assert accuracy([p3p_scene(outliers=5, noise=0.5, seed=seed) for seed in SEEDS]) >= 0.97


def test_up2p_with_ten_outliers() -> None:
    assert accuracy([up2p_scene(outliers=10, noise=1.0, seed=seed) for seed in SEEDS]) >= 0.99


def test_three_plus_one_at_the_small_baseline() -> None:
    scenes = [three_plus_one_scene(noise=0.5, seed=seed, baseline=1.0) for seed in SEEDS]
    assert accuracy(scenes) >= 0.95


def test_prior_of_a_small_baseline_helps_where_it_holds() -> None:
    scenes = [three_plus_one_scene(noise=1.0, seed=seed, baseline=1.0) for seed in SEEDS[:15]]
    told = [replace(scene, problem=replace(scene.problem, small_baseline=3e-8)) for scene in scenes]
    assert accuracy(told) >= max(0.98, accuracy(scenes))


@pytest.mark.parametrize("make", [p3p_scene, up2p_scene])
def test_paper_preset_without_noise(make) -> None:  # type: ignore[no-untyped-def]
    scenes = [make(seed=seed) for seed in range(5000, 5003)]
    assert accuracy(scenes, preset="paper", samples=1_000_000) == 1.0


def test_result_is_complete_and_coherent() -> None:
    scene = p3p_scene(outliers=4, noise=0.5, seed=7)
    seen: list[tuple[int, int]] = []
    match = rm.match(
        scene.source,
        scene.target,
        scene.problem,
        noise=0.5,
        sampler="exhaustive",
        progress=lambda done, total: seen.append((done, total)),
    )
    assert match.assignment.dtype == np.int64
    assert match.assignment.shape == (10,)
    assert match.soft_assignment.shape == (10, 14)
    assert match.score == pytest.approx(match.tensor.score(match.assignment))
    assert match.evaluated == 210 * 14 * 13 * 12 * 11
    assert match.status is rm.Status.MATCHED
    assert 0.1 < match.margin <= 1.0
    assert set(match.motion_labels) == {0}
    assert seen[-1][0] == seen[-1][1]
    scores = [score for _, score in match.alternatives]
    assert scores == sorted(scores, reverse=True)
    assert all(score <= match.score for score in scores)
    assert not any(np.array_equal(other, match.assignment) for other, _ in match.alternatives)


def test_points_without_image_are_left_unmatched() -> None:
    found = wrong = 0
    for seed in range(10):
        scene = p3p_scene(n=10, hidden=4, outliers=4, noise=0.5, seed=seed)
        match = rm.match(scene.source, scene.target, scene.problem, noise=0.5)
        found += int(((match.assignment == scene.truth) & (scene.truth >= 0)).sum())
        wrong += int(((match.assignment >= 0) & (match.assignment != scene.truth)).sum())
    assert found >= 98
    assert wrong <= 2


def test_two_motions_are_matched_and_labelled() -> None:
    right = labelled = 0
    for seed in range(10):
        scene = up2p_scene(noise=0.5, seed=seed, motions=2)
        match = rm.match(scene.source, scene.target, scene.problem, noise=0.5, motions=2)
        right += int((match.assignment == scene.truth).sum())
        same = match.motion_labels[:, None] == match.motion_labels[None, :]
        labelled += int((same == (scene.motions[:, None] == scene.motions[None, :])).all())
    assert right >= 97
    assert labelled >= 8


def test_order_of_points_does_not_matter() -> None:
    scene = up2p_scene(outliers=5, noise=0.5, seed=3)
    plain = rm.match(scene.source, scene.target, scene.problem, noise=0.5)
    rng = np.random.default_rng(0)
    first, second = rng.permutation(10), rng.permutation(15)
    moved = rm.match(scene.source[first], scene.target[second], scene.problem, noise=0.5)
    np.testing.assert_array_equal(second[moved.assignment], plain.assignment[first])
    assert moved.score == pytest.approx(plain.score)


def test_candidates_narrow_the_search() -> None:
    scene = p3p_scene(outliers=5, noise=0.5, seed=3)
    mask = np.random.default_rng(0).random((10, 15)) < 0.4
    mask[np.arange(10), scene.truth] = True
    everything = rm.match(scene.source, scene.target, scene.problem, noise=0.5, sampler="exhaustive")
    narrowed = rm.match(scene.source, scene.target, scene.problem, noise=0.5, sampler="exhaustive", candidates=mask)
    np.testing.assert_array_equal(narrowed.assignment, scene.truth)
    assert narrowed.evaluated < 0.3 * everything.evaluated
    source, target = np.divmod(narrowed.tensor.indices, 15)
    assert mask[source, target].all()
    prior = rm.match(scene.source, scene.target, scene.problem, noise=0.5, candidates=mask * 0.5)
    np.testing.assert_array_equal(prior.assignment, scene.truth)


@pytest.mark.parametrize(
    "problem",
    [
        rm.P3P(CAMERA),
        rm.UP2P(CAMERA, (0, 1, 0), (0, 1, 0)),
        rm.UP2PF((320.0, 240.0), (0, 1, 0), (0, 1, 0)),
        rm.ThreePlusOne(CAMERA, axis=(0, 1, 0), axis2=(0, 1, 0)),
        rm.PlanarMotion(CAMERA, axis=(0, 1, 0)),
        rm.Similarity(2),
        rm.Rigid(3),
    ],
    ids=lambda problem: problem.name,
)
def test_advice_names_what_the_problem_can_use(problem: rm.Problem) -> None:
    doubtful, distrusted = general_advice(rm.Status.AMBIGUOUS, problem), general_advice(rm.Status.UNTRUSTED, problem)
    assert problem.to_tell in doubtful
    assert problem.to_check in distrusted
    assert general_advice(rm.Status.MATCHED, problem).startswith(str(rm.Status.MATCHED))
    rng = np.random.default_rng(0)
    points = rng.normal(size=(6, problem.source_dimension))
    pixels = rng.uniform(0.0, 400.0, (6, problem.target_dimension))
    if "normals" in doubtful:
        problem.prepare(points, pixels, 1.0, normals=np.ones((6, 3)))
    else:
        with pytest.raises(rm.InputError, match="normals"):
            problem.prepare(points, pixels, 1.0, normals=np.ones((6, 3)))
    # a vertical is spoken of where the problem, or the one that is named, has one
    of = rm.UP2P if "`UP2P`" in doubtful else type(problem)
    assert "vertical" not in doubtful or "vertical_camera" in of.__dataclass_fields__
    assert ("vertical" in distrusted) == ("vertical_camera" in type(problem).__dataclass_fields__)
    assert "camera" not in distrusted or "camera" in type(problem).__dataclass_fields__


def test_advice_tells_of_detections_that_are_reported_twice() -> None:
    scene = p3p_scene(n=12, outliers=4, noise=0.5, seed=0)
    again = scene.target + np.random.default_rng(0).normal(0.0, 0.5, scene.target.shape)
    twice = rm.match(scene.source, np.vstack([scene.target, again]), scene.problem, noise=0.5)
    assert not twice
    assert "reports each point twice, merge such pairs" in twice.advice
    some = rm.match(scene.source, scene.target[:5], scene.problem, noise=0.5)
    assert not some
    assert "twice" not in some.advice


def test_a_symmetric_object_is_called_ambiguous() -> None:
    camera = rm.Camera(1000, 1000, 320, 240)
    square = np.array([[1.0, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0], [0.4, 0, 0], [-0.4, 0, 0]])
    points = square @ np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]).T + [0.1, 0.2, 12]
    match = rm.match(square, camera.project(points), rm.P3P(camera), noise=0.5)
    assert match.status is rm.Status.AMBIGUOUS
    assert "give normals, or a vertical (`UP2P`)" in match.advice
    assert match.margin < 0.1
    answers = [match.assignment, *(other for other, _ in match.alternatives)]
    assert any(np.array_equal(answer, [0, 1, 2, 3, 4, 5]) for answer in answers[:6])


def test_pose_is_recovered() -> None:
    scene = p3p_scene(noise=0.2, seed=11)
    match = rm.match(scene.source, scene.target, scene.problem, noise=0.2)
    (pose,) = match.poses
    assert pose is not None
    rotation, translation = pose
    true_rotation, true_translation = scene.poses[0]
    assert np.degrees(np.arccos((np.trace(rotation.T @ true_rotation) - 1) / 2)) < 0.5
    np.testing.assert_allclose(translation, true_translation, atol=0.1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"noise": -1.0}, "not negative"),
        ({"noise": np.nan}, "not negative"),
        ({"noise": [1.0, 1.0]}, "one number, or one for each"),
        ({"preset": "papre"}, "paper"),
        ({"residual": "svdd"}, "joint"),
        ({"solver": "hungry"}, "ascent"),
        ({"sampler": "some"}, "exhaustive"),
        ({"rho": 0.0}, "positive"),
        ({"motions": 0}, "auto"),
        ({"candidates": np.zeros((10, 10), dtype=bool)}, "no pair is allowed"),
        ({"candidates": np.ones((3, 3), dtype=bool)}, "shape"),
        ({"normals": np.ones((3, 3))}, "normals"),
        ({"max_evaluations": 1000, "sampler": "exhaustive"}, "random"),
        ({"backend": "tpu"}, "cpu"),
    ],
)
def test_bad_options_say_what_to_do(change: dict[str, object], words: str) -> None:
    scene = p3p_scene(seed=0)
    with pytest.raises(rm.InputError, match=words):
        rm.match(scene.source, scene.target, scene.problem, **change)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (np.zeros((3, 3)), "at least 4"),
        (np.zeros((10, 2)), "expected"),
        (np.full((10, 3), np.nan), "NaN"),
        (np.ones((10, 3)), "the same"),
        (np.outer(np.arange(10.0), [1, 2, 3]), "collinear"),
        ([["a"]], "numbers"),
    ],
)
def test_bad_points_say_what_to_do(source: object, words: str) -> None:
    scene = p3p_scene(seed=0)
    with pytest.raises(rm.InputError, match=words):
        rm.match(source, scene.target, scene.problem)


def test_residuals_refuse_bad_indices() -> None:
    scene = p3p_scene(seed=0)
    good = np.array([[0, 1, 2, 3]])
    for bad, words in (
        (np.array([[0, 1, 2, 10]]), "0 to 9"),
        (np.array([[0, 1, 2, 2]]), "twice"),
        (np.array([[0, 1, 2]]), "shape"),
        (np.array([[0.5, 1, 2, 3]]), "integers"),
    ):
        with pytest.raises(rm.InputError, match=words):
            rm.residuals(scene.source, scene.target, scene.problem, bad, good)
        with pytest.raises(rm.InputError, match=words):
            rm.residuals(scene.source, scene.target, scene.problem, good, bad)


def test_all_is_looked_at_where_a_search_finds_nothing_that_stands_out() -> None:
    scene = p3p_scene(10, noise=0.5, seed=3)
    everything = exhaustive_count(10, 10, 4)
    assert rm.match(scene.source, scene.target, scene.problem, noise=0.5).evaluated < everything / 20
    unrelated = np.random.default_rng(0).uniform(0.0, 600.0, (10, 2))
    match = rm.match(scene.source, unrelated, scene.problem, noise=0.5)
    # the search before it may take as long as a part of it
    assert everything < match.evaluated < (1.1 + 1.0 / LIMITS.per_searched) * everything
    assert match.status is rm.Status.UNTRUSTED
    # unless the caller allows fewer
    scene, unrelated = p3p_scene(12, noise=0.5, seed=3), np.random.default_rng(0).uniform(0.0, 600.0, (12, 2))
    maximum = exhaustive_count(12, 12, 4) - 1
    limited = rm.match(scene.source, unrelated, scene.problem, noise=0.5, max_evaluations=maximum)
    assert limited.evaluated < maximum
    assert limited.status is rm.Status.UNTRUSTED
