"""Make the files of this example from the chessboard photographs of OpenCV's samples.

    python examples/board/make_board.py FOLDER

FOLDER holds left01.jpg ... left14.jpg; Debian's package ``opencv-doc`` (``apt install opencv-doc``) installs them in
/usr/share/doc/opencv-doc/examples/data. OpenCV comes with ``pip install 'rootmatch[test]'``.

Writes ``model.csv``, ``image.csv``, ``truth.csv``, ``camera.json`` and ``calibration.json``, which README.md describes.
The model is a subset of the board's corners without any symmetry: only one assignment is right;
the image has the same corners and, as clutter, corners that OpenCV finds elsewhere in the photograph.
"""

import argparse
import itertools
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

COLUMNS, ROWS = 9, 6  # inner corners of the board
SQUARE = 25.0  # millimetres; the size that OpenCV's left_intrinsics.yml states
ENTRIES = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}  # in the intrinsic matrix
STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)

Floats = NDArray[np.float64]


def lattice() -> NDArray[np.int64]:
    """Column and row of each inner corner, (54, 2), in the order in which OpenCV detects them."""
    return np.array([(column, row) for row in range(ROWS) for column in range(COLUMNS)])


def refine(photograph: NDArray[np.uint8], corners: NDArray, half_window: int) -> NDArray[np.float32]:
    """Corners (m, 2) refined to subpixel accuracy from the image gradient."""
    start = np.ascontiguousarray(np.reshape(corners, (-1, 1, 2)), dtype=np.float32)
    return cv2.cornerSubPix(photograph, start, (half_window, half_window), (-1, -1), STOP).reshape(-1, 2)


def detect(photograph: NDArray[np.uint8]) -> NDArray[np.float32] | None:
    """All inner corners of the board, (54, 2) in distorted pixels, or None where not all are visible."""
    found, corners = cv2.findChessboardCorners(photograph, (COLUMNS, ROWS))
    if not found:
        return None
    grid = corners.reshape(ROWS, COLUMNS, 2)
    spacing = min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1))
    # A window that reaches the next corner would be attracted to it.
    return refine(photograph, corners, int(np.clip(0.4 * spacing, 3, 11)))


def calibrate(boards: list[NDArray[np.float32]], size: tuple[int, int]) -> tuple[Floats, Floats, float]:
    """Intrinsic matrix (3, 3), distortion coefficients and RMS reprojection error in pixels of all boards."""
    model = np.zeros((COLUMNS * ROWS, 3), np.float32)
    model[:, :2] = lattice() * SQUARE
    rms, K, distortion, _, _ = cv2.calibrateCamera([model] * len(boards), boards, size, None, None)
    return K, distortion.ravel(), float(rms)


def largest_overlap(points: NDArray[np.int64]) -> int:
    """Number of points of a lattice subset (n, 2) that its most nearly symmetric map sends to points of the subset.

    Tries all rotations, reflections and translations of the square lattice except the identity. A symmetric subset
    gives n.
    """
    own = {(int(x), int(y)) for x, y in points}
    maximum = 0
    for swap, sx, sy in itertools.product((False, True), (1, -1), (1, -1)):
        rotated = (points[:, ::-1] if swap else points) * (sx, sy)
        shifts: dict[tuple[int, int], int] = {}
        for x, y in own:
            for u, v in rotated:
                shift = (x - int(u), y - int(v))
                shifts[shift] = shifts.get(shift, 0) + 1
        if not swap and sx == sy == 1:
            del shifts[0, 0]
        maximum = max(maximum, *shifts.values())
    return maximum


def collinear_triples(points: NDArray[np.int64]) -> int:
    """Number of collinear triples among points (n, 2)."""
    count = 0
    for (ax, ay), (bx, by), (cx, cy) in itertools.combinations(points.tolist(), 3):
        count += (bx - ax) * (cy - ay) == (by - ay) * (cx - ax)
    return count


def choose_corners(count: int, rng: np.random.Generator, tries: int = 3000) -> NDArray[np.int64]:
    """Indices of ``count`` corners: of many random subsets, the least symmetric with the fewest collinear triples."""
    everything = lattice()
    best, best_fault = None, (np.inf, np.inf)
    for _ in range(tries):
        chosen = np.sort(rng.choice(len(everything), count, replace=False))
        points = everything[chosen]
        if np.any(np.ptp(points, axis=0) < (COLUMNS - 2, ROWS - 2)):
            continue  # spread over the board: a distant camera resolves a small patch poorly
        fault = (largest_overlap(points), collinear_triples(points))
        if fault < best_fault:
            best, best_fault = chosen, fault
    assert best is not None
    return best


def clutter(photograph: NDArray[np.uint8], board: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """The ``count`` strongest corners outside the board, (count, 2) in distorted pixels."""
    outline = cv2.convexHull(board).reshape(-1, 2)
    centre = outline.mean(axis=0)
    # The outer squares and the border reach about two squares beyond the inner corners.
    wide = np.round(centre + (outline - centre) * (1.0 + 4.0 / (ROWS - 1))).astype(np.int32)
    mask = np.full(photograph.shape, 255, np.uint8)
    cv2.fillConvexPoly(mask, wide, 0)
    mask[:10], mask[-10:], mask[:, :10], mask[:, -10:] = 0, 0, 0, 0
    corners = cv2.goodFeaturesToTrack(photograph, count, 0.05, 25, mask=mask)
    if corners is None or len(corners) < count:
        raise SystemExit(f"only {0 if corners is None else len(corners)} clutter corners found, {count} needed")
    return refine(photograph, corners, 3)


def write_together(folder: Path, files: dict[str, str]) -> None:
    """Write files into ``folder``: to a temporary folder first, so that no partial file ever appears."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".unfinished-") as beside:
        for name, text in files.items():
            (Path(beside) / name).write_text(text, encoding="utf-8")
        for name in files:
            os.replace(Path(beside) / name, folder / name)


def table(header: list[str], rows: list[list[Any]]) -> str:
    """CSV text of a header and rows."""
    return "".join(",".join(str(cell) for cell in row) + "\n" for row in [header, *rows])


def make(folder: Path, photograph_name: str, count: int, clutter_count: int, seed: int) -> dict[str, str]:
    """Names and texts of the files."""
    boards: dict[str, NDArray[np.float32]] = {}
    photographs: dict[str, NDArray[np.uint8]] = {}
    for path in sorted(folder.glob("left[0-9][0-9].jpg")):
        photograph = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        corners = None if photograph is None else detect(photograph)
        if corners is not None:
            boards[path.name], photographs[path.name] = corners, photograph
    if photograph_name not in boards:
        raise SystemExit(f"{folder / photograph_name}: no photograph with a whole {COLUMNS} x {ROWS} board there")

    photograph, board = photographs[photograph_name], boards[photograph_name]
    height, width = photograph.shape
    K, distortion, rms = calibrate(list(boards.values()), (width, height))

    rng = np.random.default_rng(seed)
    chosen = rng.permutation(choose_corners(count, rng))
    model = np.column_stack([lattice()[chosen] * SQUARE, np.zeros(count)])
    visible = np.concatenate([board[chosen], clutter(photograph, board, clutter_count)]).astype(np.float64)
    pixels = cv2.undistortPoints(visible.reshape(-1, 1, 2), K, distortion, P=K).reshape(-1, 2)
    order = rng.permutation(len(pixels))  # image point k is detection order[k]
    index = np.argsort(order)

    camera = {
        **{name: round(float(K[entry]), 4) for name, entry in ENTRIES.items()},
        "width": width,
        "height": height,
    }
    calibration = {
        "photograph": photograph_name,
        "photographs_used": len(boards),
        "rms_px": round(rms, 4),
        "distortion_removed": {
            name: round(float(value), 6) for name, value in zip(("k1", "k2", "p1", "p2", "k3"), distortion, strict=True)
        },
        "square_mm": SQUARE,
    }
    points = [[i, *(f"{value:g}" for value in point)] for i, point in enumerate(model)]
    detections = [[i, *(f"{value:.3f}" for value in point)] for i, point in enumerate(pixels[order])]
    return {
        "model.csv": table(["id", "x", "y", "z"], points),
        "image.csv": table(["id", "x", "y"], detections),
        "truth.csv": table(["source", "target"], [[i, int(index[i])] for i in range(count)]),
        "camera.json": json.dumps(camera, indent=2) + "\n",
        "calibration.json": json.dumps(calibration, indent=2) + "\n",
    }


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Make the board example from OpenCV's chessboard photographs.")
    parser.add_argument("folder", type=Path, help="folder of left01.jpg ... (Debian package opencv-doc)")
    parser.add_argument("--photograph", default="left11.jpg", help="which one becomes the image (default %(default)s)")
    parser.add_argument("--corners", type=int, default=14, help="board corners of the model (default %(default)s)")
    parser.add_argument("--clutter", type=int, default=8, help="corners from elsewhere (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="choice and order of the points (default %(default)s)")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="default: next to this script")
    arguments = parser.parse_args()
    if not arguments.folder.is_dir():
        raise SystemExit(f"{arguments.folder}: no such folder; install Debian's opencv-doc or give its examples/data")
    files = make(arguments.folder, arguments.photograph, arguments.corners, arguments.clutter, arguments.seed)
    write_together(arguments.output, files)
    print("wrote", ", ".join(str(arguments.output / name) for name in files))
    return 0


if __name__ == "__main__":
    sys.exit(main())
