"""Draw docs/hero.png, the picture of the README: a photograph, its detections, and what rootmatch makes of them.

    apt install opencv-doc
    python docs/make_hero_picture.py /usr/share/doc/opencv-doc/examples/data

The points are those of examples/board; the photograph belongs to OpenCV's samples (Apache License 2.0).
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from pathlib import Path

os.environ["MPLBACKEND"] = "agg"

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes

import rootmatch as rm

HERE = Path(__file__).resolve().parent
BOARD = HERE.parent / "examples" / "board"
NOISE = 0.3
"""Pixels, as in the demonstration of the board."""
AXIS = 50.0
"""Length of the drawn axes in millimetres: two squares."""
SEEN, FOUND, LOST = "#ffb000", "#00e08a", "#ff4f6d"
RIM = [patheffects.withStroke(linewidth=3.5, foreground="black")]
X_RANGE, Y_RANGE = (0.0, 600.0), (478.0, 2.0)
"""The part of the photograph that is shown, in pixels."""


def columns(name: str, *names: str) -> np.ndarray:
    """Columns of a file of the board."""
    table = np.genfromtxt(BOARD / name, delimiter=",", names=True)
    return np.column_stack([table[one] for one in names])


def photograph(folder: Path) -> np.ndarray:
    """The photograph without the distortion of its lens."""
    calibration = json.loads((BOARD / "calibration.json").read_text())
    dist = np.array([calibration["distortion_removed"][name] for name in ("k1", "k2", "p1", "p2", "k3")])
    image = cv2.imread(str(folder / calibration["photograph"]), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SystemExit(f"{folder} holds no {calibration['photograph']}; install opencv-doc and name its folder")
    return cv2.undistort(image, intrinsics(), dist)


def intrinsics() -> np.ndarray:
    camera = json.loads((BOARD / "camera.json").read_text())
    return np.array([[camera["fx"], 0.0, camera["cx"]], [0.0, camera["fy"], camera["cy"]], [0.0, 0.0, 1.0]])


def panel(axes: Axes, image: np.ndarray, title: str) -> None:
    axes.imshow(image, cmap="gray", vmin=0, vmax=420, interpolation="bilinear")  # darkened, for the marks
    axes.set(xlim=X_RANGE, ylim=Y_RANGE, xticks=[], yticks=[])
    box = {"facecolor": "black", "alpha": 0.75, "edgecolor": "none", "pad": 5}
    axes.text(0.012, 0.975, title, transform=axes.transAxes, va="top", fontsize=14, color="white", bbox=box)
    for side in axes.spines.values():
        side.set_visible(False)


def free_places(points: np.ndarray, shown: np.ndarray, busy: np.ndarray) -> np.ndarray:
    """A place for the label of each shown point, away from all points, other labels and the axes."""
    angles = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    places: list[np.ndarray] = []
    for i in shown:
        others = np.vstack([np.delete(points, i, axis=0), busy, *places]) if places else np.vstack([points, busy])
        tried = np.vstack([points[i] + radius * ring for radius in (17.0, 20.0)])
        gap = np.linalg.norm(tried[:, None] - others[None], axis=2).min(axis=1)
        places.append(tried[gap.argmax()][None])
    return np.vstack(places)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", type=Path, help="folder of OpenCV's left11.jpg")
    image = photograph(parser.parse_args().photographs)
    model, detections = columns("model.csv", "x", "y", "z"), columns("image.csv", "x", "y")
    truth = np.full(len(model), -1)
    source, target = columns("truth.csv", "source", "target").astype(int).T
    truth[source] = target

    K = intrinsics()
    match = rm.match(model, detections, rm.P3P(rm.Camera.from_matrix(K)), noise=NOISE)
    right = int(((match.assignment == truth) & (truth >= 0)).sum())
    pose = match.poses[0]
    print(f"{match.status.name}: {right} of {(truth >= 0).sum()} right, RMS {pose.rms:.2f} px")

    figure, (given, found) = plt.subplots(1, 2, figsize=(13.0, 5.12))
    figure.patch.set_alpha(0.0)
    figure.subplots_adjust(0.0, 0.0, 1.0, 1.0, wspace=0.012)
    panel(given, image, f"In: {len(detections)} detections, {len(model)} model points")
    given.scatter(*detections.T, s=85, facecolors="none", edgecolors=SEEN, linewidths=2.2)
    plan = given.inset_axes((0.765, 0.02, 0.225, 0.30))
    plan.scatter(*model[:, :2].T, s=22, color=SEEN)
    plan.set(xticks=[], yticks=[], facecolor="#101418")
    plan.set_aspect("equal", adjustable="datalim")
    plan.margins(0.18)
    plan.invert_yaxis()
    plan.set_title("the model, mm", fontsize=11, color="white", y=0.0, pad=3)

    panel(found, image, f"Out: {right} of {len(model)} identified, and the pose")
    matched = match.assignment[match.assignment >= 0]
    clutter = np.setdiff1d(np.arange(len(detections)), matched)
    origin = model.mean(axis=0) * (1.0, 1.0, 0.0)
    tips = origin + AXIS * np.diag([1.0, 1.0, -1.0])
    R, t = pose
    drawn = cv2.projectPoints(np.vstack([origin, tips]), cv2.Rodrigues(np.array(R))[0], np.array(t), K, None)[0][:, 0]
    for tip, colour, name in zip(drawn[1:], ("#ff4040", "#40d040", "#5090ff"), "xyz", strict=True):
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 3.5, "shrinkA": 0, "shrinkB": 0}
        found.annotate("", tip, drawn[0], arrowprops=arrow)
        beyond = tip + 9.0 * (tip - drawn[0]) / np.linalg.norm(tip - drawn[0])
        text = found.text(*beyond, name, color=colour, fontsize=17, weight="bold", ha="center", va="center")
        text.set_path_effects(RIM)
    found.scatter(*detections[clutter].T, s=65, marker="x", color=LOST, linewidths=2.4)
    found.scatter(*detections[matched].T, s=85, facecolors="none", edgecolors=FOUND, linewidths=2.4)
    lines = [np.linspace(drawn[0], tip, 8) for tip in drawn[1:]]
    busy = np.vstack([*lines, detections])
    shown = np.flatnonzero(match.assignment >= 0)
    for i, place in zip(shown, free_places(detections, match.assignment[shown], busy), strict=True):
        text = found.text(*place, str(i), color="white", fontsize=15, weight="bold", ha="center", va="center")
        text.set_path_effects(RIM)
    figure.savefig(HERE / "hero.png", dpi=100)
    _check_labels(found)


def _check_labels(axes: Axes) -> None:
    """No two labels overlap."""
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text() and text.get_bbox_patch() is None]
    clash = [1 for one, other in itertools.combinations(boxes, 2) if one.overlaps(other)]
    if clash:
        raise SystemExit(f"{len(clash)} labels overlap")


if __name__ == "__main__":
    main()
