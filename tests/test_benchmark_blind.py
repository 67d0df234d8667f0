"""The benchmark on blind PnP: its scenes are what they say, its baselines work, its judge cannot be fooled."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from rootmatch.cli.app import app
from rootmatch.errors import InputError
from rootmatch.research.blind import methods as blind_methods
from rootmatch.research.blind.methods import Answer, load_peer, methods
from rootmatch.research.blind.run import COLUMNS, judge_answer, run_blind
from rootmatch.research.blind.scenes import (
    HEIGHT,
    NOISE,
    OUTLIERS,
    SURFACES,
    WIDTH,
    BlindScene,
    outlier_scene,
    project_points,
    real_scenes,
    simulated_scenes,
    surface_scene,
)
from rootmatch.research.blind.softposit import _softassign, softposit


def distances(scene: BlindScene) -> np.ndarray:
    """From each detection to the nearest true projection, in pixels."""
    image = project_points(scene.K, scene.R, scene.t, scene.source)
    return np.linalg.norm(scene.target[:, None] - image[None], axis=2).min(axis=1)


@pytest.mark.parametrize("row", OUTLIERS)
def test_outlier_scenes_have_their_shares(row: tuple[float, float]) -> None:
    unseen, clutter = row
    for seed in range(3):
        scene = outlier_scene(*row, seed)
        seen = round(30 * (1.0 - unseen))
        assert len(scene.source) == 30
        assert len(scene.target) == pytest.approx(seen / (1.0 - clutter), abs=1)
        assert np.sum(distances(scene) < 5.0 * NOISE) >= seen
        assert np.all((scene.source >= -1.0) & (scene.source <= 1.0))
        image = project_points(scene.K, scene.R, scene.t, scene.source)
        assert np.all((image > 0.0) & (image < (WIDTH, HEIGHT)))


@pytest.mark.parametrize("row", SURFACES[:2])
def test_surface_scenes_show_every_point(row: tuple[int, float]) -> None:
    scene = surface_scene(*row, 4)
    assert len(scene.source) == row[0]
    assert len(scene.target) == row[0] / (1.0 - row[1])
    assert np.sum(distances(scene) < 5.0 * NOISE) >= row[0]


def test_noise_is_as_said_and_seeds_differ() -> None:
    scene = surface_scene(1000, 0.0, 1)
    image = project_points(scene.K, scene.R, scene.t, scene.source)
    order = np.linalg.norm(scene.target[:, None] - image[None], axis=2)
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(np.minimum(order, 50.0))
    assert np.sqrt(np.mean((scene.target[rows] - image[columns]) ** 2)) < 1.1 * NOISE
    assert not np.allclose(scene.R, surface_scene(1000, 0.0, 2).R)
    np.testing.assert_array_equal(scene.target, surface_scene(1000, 0.0, 1).target)
    assert len(list(simulated_scenes(range(3, 5), ("outliers",)))) == 2 * len(OUTLIERS)


def test_the_judge_knows_the_truth_and_what_is_far_from_it() -> None:
    scene = outlier_scene(0.0, 0.0, 0)
    exact = judge_answer(scene, Answer((scene.R, scene.t), True), 1.0)
    assert exact["right"]
    assert exact["degrees"] == pytest.approx(0.0, abs=1e-3)
    turned = np.diag([1.0, -1.0, -1.0]) @ scene.R
    assert not judge_answer(scene, Answer((turned, scene.t), True), 1.0)["right"]
    assert not judge_answer(scene, Answer((scene.R, 1.2 * scene.t), True), 1.0)["right"]
    assert not judge_answer(scene, Answer(None, False), 1.0)["right"]
    assert not judge_answer(scene, Answer((scene.R, np.full(3, np.nan)), True), 1.0)["right"]


def test_softposit_ends_where_detections_lead_to_no_pose() -> None:
    """All at the principal point: the scale of every pose that they lead to is zero."""
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (9, 3))
    start = np.eye(3), np.array([0.0, 0.0, 5.0])
    R, t = softposit(points, np.zeros((6, 2)), 500.0, 2.0, start=start)
    np.testing.assert_array_equal(R, start[0])
    np.testing.assert_array_equal(t, start[1])


def test_softposit_finds_the_pose_from_a_near_start() -> None:
    from scipy.spatial.transform import Rotation

    right = 0
    for seed in range(5):
        scene = outlier_scene(0.0, 0.25, seed)
        R = Rotation.from_rotvec([0.15, -0.1, 0.1]).as_matrix() @ scene.R
        found = softposit(
            scene.source, scene.target - scene.K[:2, 2], scene.K[0, 0], scene.noise, start=(R, 1.1 * scene.t)
        )
        np.testing.assert_allclose(found[0] @ found[0].T, np.eye(3), atol=1e-9)
        right += judge_answer(scene, Answer(found, True), 0.0)["right"]
    assert right >= 4


def test_softassign_is_doubly_stochastic_with_slack() -> None:
    weights = np.random.default_rng(0).uniform(0.0, 20.0, (5, 7))
    pairs = _softassign(weights)
    assert np.all(pairs >= 0.0)
    assert np.all(pairs.sum(axis=0) <= 1.0 + 1e-3)
    assert np.all(pairs.sum(axis=1) <= 1.0 + 1e-3)
    assert _softassign(np.eye(4) * 1e6 + 1e-6).argmax(axis=1).tolist() == [0, 1, 2, 3]


def test_descent_settles_on_the_truth_and_its_step_is_the_gradients() -> None:
    from scipy.spatial.transform import Rotation

    scene = outlier_scene(0.0, 0.0, 3)
    start = Rotation.from_rotvec([0.03, 0.02, -0.03]).as_matrix() @ scene.R, scene.t + 0.05
    found = blind_methods._descend_icp(scene, *start)
    assert judge_answer(scene, Answer(found, True), 0.0)["degrees"] < 1.0
    assert len(blind_methods._mutual_nearest_pairs(scene, *found, 3.0 * NOISE)[0]) >= 27


def test_icp_solves_a_scene_without_outliers() -> None:
    scene = outlier_scene(0.0, 0.0, 1)
    answer = blind_methods.solve_by_icp(scene, 20.0)
    assert judge_answer(scene, answer, 0.0)["right"]


def test_all_methods_answer_in_a_tiny_run_that_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, few in (("STARTS", 3), ("OPENCV_ITERATIONS", 100), ("POSELIB_ITERATIONS", 1000)):
        monkeypatch.setattr(blind_methods, name, few)
    peer = tmp_path / "peer.py"
    peer.write_text("def ransac_match(points, pixels, K, tolerance, max_seconds, seed):\n    return [], None, 0\n")
    first = run_blind(tmp_path / "out", tiny=True, first_seed=1, seconds=60.0, peer=peer)
    assert first[0] == COLUMNS
    assert {line[1] for line in first[1:]} == set(methods(peer))
    by_name = {line[1]: dict(zip(COLUMNS, line, strict=True)) for line in first[1:]}
    assert by_name["rootmatch"]["right"] == "1"
    assert by_name["brute force"]["right"] == by_name["brute force"]["vouched for"] == "0"
    rows = (tmp_path / "out" / "rows.jsonl").read_text()
    assert run_blind(tmp_path / "out", tiny=True, first_seed=1, seconds=60.0, peer=peer) == first
    assert (tmp_path / "out" / "rows.jsonl").read_text() == rows
    with (tmp_path / "out" / "blind.csv").open(encoding="utf-8") as file:
        assert [tuple(line) for line in csv.reader(file)] == first
    one = run_blind(tmp_path / "one", tiny=True, first_seed=1, seconds=60.0, only_methods=["rootmatch"])
    assert [line[1] for line in one[1:]] == ["rootmatch"]
    with pytest.raises(InputError, match=r"^method: brute force given; give one of rootmatch, "):
        run_blind(tmp_path / "one", tiny=True, only_methods=["brute force"])


def test_real_scenes_have_the_pose_of_their_true_pairs(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (20, 3))
    K = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])
    t = np.array([0.0, 0.0, 6.0])
    image = np.stack([project_points(K, np.eye(3), t, points) + 0.3 * rng.normal(size=(20, 2)) for _ in range(2)])
    np.savez(tmp_path / "tears_of_steel_01.npz", points3d=points, points2d=image, K=np.array([K, K]), rms_px=[0.3, 0.3])
    for name in ("aicon_targets", "berlin_facade"):
        np.savez(tmp_path / f"{name}.npz", nothing=0)
    with pytest.raises(InputError, match="does not hold"):
        list(real_scenes(tmp_path, 1))
    for name in ("aicon_targets", "berlin_facade"):
        (tmp_path / f"{name}.npz").unlink()
    (scene,) = real_scenes(tmp_path, 1)
    assert judge_answer(scene, Answer((np.eye(3), t), True), 0.0)["right"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--protocol", "learned"], "learned"),
        (["--protocol", "real"], "--data"),
        (["--scenes", "0"], "0 scenes"),
        (["--timeout", "0"], "0 s each"),
        (["--peer", "nowhere.py"], "nowhere.py"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, options: list[str], words: str) -> None:
    result = CliRunner().invoke(app, ["benchmark", "blind", "--output", str(tmp_path / "out"), *options])
    assert result.exit_code == 2
    assert words in result.stderr
    assert not (tmp_path / "out" / "rows.jsonl").exists()


def test_the_command_needs_a_folder() -> None:
    result = CliRunner().invoke(app, ["benchmark", "blind"])
    assert result.exit_code == 2
    assert "--output" in result.stderr


def test_a_peer_is_a_file_with_a_function(tmp_path: Path) -> None:
    path = tmp_path / "known.py"
    path.write_text(
        "import numpy as np\n"
        "def ransac_match(points, pixels, K, tolerance, max_seconds, seed):\n"
        "    return np.zeros(len(points), int), (np.eye(3), np.array([0.0, 0.0, tolerance])), 5\n"
    )
    answer = load_peer(path)(outlier_scene(0.0, 0.0, 0), 1.0)
    assert answer.claimed
    assert answer.pose is not None
    assert answer.pose[1][2] == 3.0 * NOISE
