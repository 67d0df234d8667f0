"""The committed files of examples/board say one coherent thing, and the matcher finds it."""

import csv
import importlib.util
import itertools
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

BOARD = Path(__file__).resolve().parents[1] / "examples" / "board"
SQUARE = 25.0


class Board(NamedTuple):
    model: NDArray[np.float64]
    image: NDArray[np.float64]
    truth: NDArray[np.int64]
    K: NDArray[np.float64]
    size: tuple[int, int]


def read(name: str, columns: str) -> NDArray[np.float64]:
    with (BOARD / name).open(newline="", encoding="utf-8") as lines:
        return np.array([[float(row[column]) for column in columns.split(",")] for row in csv.DictReader(lines)])


@pytest.fixture(scope="module")
def board() -> Board:
    camera = json.loads((BOARD / "camera.json").read_text(encoding="utf-8"))
    K = np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1.0]])
    pairs = read("truth.csv", "source,target").astype(np.int64)
    assert pairs[:, 0].tolist() == list(range(len(pairs)))
    size = camera["width"], camera["height"]
    return Board(read("model.csv", "x,y,z"), read("image.csv", "x,y"), pairs[:, 1], K, size)


def load(name: str) -> ModuleType:
    """A script of the example as a module."""
    spec = importlib.util.spec_from_file_location(name, BOARD / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load("make_board")


def reprojected(board: Board) -> NDArray[np.float64]:
    """Where the pose of OpenCV puts each model point, in pixels."""
    found, rotation, translation = cv2.solvePnP(board.model, board.image[board.truth], board.K, None)
    assert found
    return cv2.projectPoints(board.model, rotation, translation, board.K, None)[0].reshape(-1, 2)


def max_kept(points: NDArray[np.float64]) -> int:
    """The most points of a lattice subset (n, 2) that one of its maps other than the identity puts onto the subset.

    Complex numbers: a rotation by a quarter turn is a product with i, a reflection a conjugation.
    """
    own = points[:, 0] + 1j * points[:, 1]
    maximum = 0
    for turn, mirrored in itertools.product((1, 1j, -1, -1j), (False, True)):
        turned = turn * (np.conj(own) if mirrored else own)
        for shift in np.unique(np.subtract.outer(own, turned)):
            if turn == 1 and not mirrored and shift == 0:
                continue
            maximum = max(maximum, int(np.isin(turned + shift, own).sum()))
    return maximum


def test_ids_are_the_rows() -> None:
    for name in ("model.csv", "image.csv"):
        ids = read(name, "id")[:, 0]
        assert ids.tolist() == list(range(len(ids)))


def test_enough_corners_and_clutter(board: Board) -> None:
    assert len(board.model) >= 12
    assert len(np.unique(board.truth)) == len(board.truth) == len(board.model)
    assert len(board.image) - len(board.truth) >= 8


def test_order_tells_nothing(board: Board) -> None:
    assert (np.diff(board.truth) < 0).any()
    assert (board.truth == np.arange(len(board.truth))).mean() < 0.5


def test_truth_reprojects_within_a_pixel(board: Board) -> None:
    error = np.linalg.norm(reprojected(board) - board.image[board.truth], axis=1)
    assert error.max() < 1.0


def test_a_wrong_truth_would_not_reproject(board: Board) -> None:
    swapped = board.truth.copy()
    swapped[[0, 1]] = swapped[[1, 0]]
    error = np.linalg.norm(reprojected(board._replace(truth=swapped)) - board.image[swapped], axis=1)
    assert error.max() > 5.0


def test_clutter_lies_off_the_board(board: Board) -> None:
    plane, _ = cv2.findHomography(board.image[board.truth], board.model[:, :2])
    clutter = np.delete(board.image, board.truth, axis=0)
    squares = cv2.perspectiveTransform(clutter.reshape(-1, 1, 2), plane).reshape(-1, 2) / SQUARE
    # Inner corners are 0..8 x 0..5; the squares around them end one further out.
    inside = (squares[:, 0] > -1) & (squares[:, 0] < 9) & (squares[:, 1] > -1) & (squares[:, 1] < 6)
    assert not inside.any()
    assert (clutter > 0).all()
    assert (clutter < board.size).all()


def test_subset_has_no_symmetry(board: Board) -> None:
    lattice = board.model[:, :2] / SQUARE
    np.testing.assert_array_equal(lattice, np.round(lattice))
    assert max_kept(lattice) <= len(lattice) // 2


@pytest.mark.parametrize("seed", range(5))
def test_scripts_own_symmetry_count(script: ModuleType, seed: int) -> None:
    points = script.lattice()[np.random.default_rng(seed).choice(54, 10, replace=False)]
    assert script.largest_overlap(points) == max_kept(points)


def test_symmetric_subsets_are_seen(script: ModuleType) -> None:
    assert script.largest_overlap(script.lattice()) == 54
    assert script.largest_overlap(np.array([(0, 0), (1, 0), (3, 1), (2, 1)])) == 4
    assert script.collinear_triples(np.array([(0, 0), (1, 1), (2, 2), (3, 0), (0, 5)])) == 1


def test_script_sees_and_calibrates_drawn_boards(script: ModuleType, board: Board) -> None:
    """Boards drawn by a known camera: corners to a tenth of a pixel, focal length to half a percent, no distortion."""
    K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    squares = np.kron([[(i + j) % 2 for i in range(10)] for j in range(7)], np.ones((40, 40)))
    texture = np.full((360, 480), 255, np.uint8)
    texture[40:320, 40:440] = 255 * squares
    to_board = np.array([[1 / 40, 0, -2 + 0.5 / 40], [0, 1 / 40, -2 + 0.5 / 40], [0, 0, 1]]) * SQUARE
    to_board[2, 2] = 1
    boards, errors = [], []
    for turn in ((0.5, 0.1, 0.1), (-0.4, 0.3, 0.0), (0.1, -0.6, 0.2), (0.2, 0.5, -0.2), (-0.5, -0.3, 0.1)):
        R = cv2.Rodrigues(np.array(turn))[0]
        t = np.array([0, 0, 400]) - R @ (np.array([4, 2.5, 0]) * SQUARE)
        H = K @ np.column_stack([R[:, 0], R[:, 1], t])
        large = cv2.warpPerspective(texture, np.diag([4, 4, 1]) @ H @ to_board, (2560, 1920), borderValue=255)
        corners = script.detect(cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA))
        assert corners is not None
        exact = cv2.perspectiveTransform(script.lattice().reshape(-1, 1, 2) * SQUARE, H).reshape(-1, 2)
        # Detected either way round, and pixel centres are half a pixel off the corner of the larger picture's grid.
        exact += 0.5 / 4 - 0.5
        errors.append(min(np.linalg.norm(corners - e, axis=1).max() for e in (exact, exact[::-1])))
        boards.append(corners)
    assert max(errors) < 0.1
    found, distortion, rms = script.calibrate(boards, board.size)
    assert rms < 0.1
    np.testing.assert_allclose(found[[0, 1], [0, 1]], 600, rtol=5e-3)
    assert abs(distortion[0]) < 0.05  # k1; the higher terms are poorly determined by five boards


def test_files_are_written_together(script: ModuleType, tmp_path: Path) -> None:
    script.write_together(tmp_path / "new", {"a.csv": "x\n", "b.csv": "y\n"})
    script.write_together(tmp_path / "new", {"a.csv": "z\n"})
    assert {path.name: path.read_text() for path in (tmp_path / "new").iterdir()} == {"a.csv": "z\n", "b.csv": "y\n"}


def test_script_names_what_is_missing(script: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="left11"):
        script.make(tmp_path, "left11.jpg", 14, 8, 0)


@pytest.mark.parametrize("noise", [0.15, 0.6])
def test_match_finds_every_corner(board: Board, noise: float) -> None:
    import rootmatch as rm

    problem = rm.P3P(rm.Camera.from_matrix(board.K))
    match = rm.match(board.model, board.image, problem, noise=noise, seed=0)
    np.testing.assert_array_equal(match.assignment, board.truth)
    assert match.status is rm.Status.MATCHED


def test_demonstration(tmp_path: Path) -> None:
    command = [sys.executable, str(BOARD / "demo.py"), "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    assert "14 of 14 right\n" in done.stdout
    assert str(tmp_path / "match.png") in done.stdout
    assert (tmp_path / "match.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ([(0, 10), (1, 12), (2, 0)], "1 of 14 right"),
        ([], "0 of 14 right"),
        (None, "exit code 1"),
    ],
    ids=["exchanged", "nothing matched", "nothing written"],
)
def test_demonstration_sees_a_wrong_answer(
    answer: list | None, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    demo = load("demo")

    def tool(command: list[str], **_: object) -> subprocess.CompletedProcess:
        if answer is not None:
            rows = "".join(f"{source},{target},1.0,0\n" for source, target in answer)
            (tmp_path / "matches.csv").write_text("source,target,weight,motion\n" + rows)
            (tmp_path / "match.png").write_bytes(b"")
        return subprocess.CompletedProcess(command, 0 if answer else 1)

    (tmp_path / "matches.csv").write_text((BOARD / "truth.csv").read_text())  # an earlier run's answer
    monkeypatch.setattr(demo.subprocess, "run", tool)
    monkeypatch.setattr(sys, "argv", ["demo.py", "--output", str(tmp_path)])
    assert demo.main() == 1
    printed = capsys.readouterr()
    assert said in printed.out + printed.err
