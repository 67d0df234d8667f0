"""The picture of a match: what it shows, where the lines end, and how it is written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imsave
from matplotlib.patches import ConnectionPatch
from mpl_toolkits.mplot3d import proj3d
from numpy.typing import NDArray

import rootmatch as rm
from pose_scenes import p3p, point_sets
from rootmatch.errors import InputError
from rootmatch.report.drawn_poses import REACH, RESIDUAL
from rootmatch.report.pictures import UNMATCHED, WRONG, check_picture, match_figure, save_figure

Floats = NDArray[np.float64]


def look_at(count: int, seed: int) -> tuple[Floats, Floats]:
    """Points in a cube and their pixels from a random direction, written out without the package."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2.0, 2.0, (count, 3))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    seen = points @ rotation.T + [0.0, 0.0, 12.0]
    return points, 1000.0 * seen[:, :2] / seen[:, 2:] + [320.0, 240.0]


def lines_of(figure: Any) -> list[ConnectionPatch]:
    return [artist for artist in figure.artists if isinstance(artist, ConnectionPatch)]


def ends_of(figure: Any) -> Floats:
    """Both ends (k, 2, 2) of each line, left end first, in pixels of the page."""
    return np.array([line.get_transform().transform(line.get_path().vertices[[0, -1]]) for line in lines_of(figure)])


def page_places(figure: Any, source: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Where the points of both sides fall on the page, in pixels."""
    left, right = figure.axes
    flat = source if source.shape[1] == 2 else np.column_stack(proj3d.proj_transform(*source.T, left.get_proj())[:2])
    return left.transData.transform(flat), right.transData.transform(target)


def legend_texts(figure: Any) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize("dimension", [2, 3])
def test_each_line_joins_a_source_point_to_its_match(dimension: int) -> None:
    source, target = look_at(12, seed=1)
    source = source if dimension == 3 else target + np.array([15.0, 0.0])
    assignment = np.array([3, -1, 0, 1, -1, 11, 10, 9, 8, 7, 6, 5])
    figure = match_figure(source, target, assignment)
    figure.canvas.draw()
    left, right = page_places(figure, source, target)
    chosen = np.flatnonzero(assignment >= 0)
    ends = ends_of(figure)
    np.testing.assert_allclose(ends[:, 0], left[chosen], atol=0.01)
    np.testing.assert_allclose(ends[:, 1], right[assignment[chosen]], atol=0.01)
    sides = ("the model", "the image") if dimension == 3 else ("the first image", "the second image")
    assert legend_texts(figure) == ["matched (10)", f"unmatched in {sides[0]} (2)", f"unmatched in {sides[1]} (2)"]
    titles = {axes.get_title() for axes in figure.axes} | {text.get_text() for text in figure.texts}
    assert {side.removeprefix("the ") for side in sides} <= titles


def test_unmatched_points_are_drawn_apart_on_both_sides() -> None:
    source, target = look_at(6, seed=2)
    assignment = np.array([0, 1, 2, 3, -1, -1])
    figure = match_figure(source, target, assignment)
    grey = [line for axes in figure.axes for line in axes.lines if to_hex(line.get_color()).upper() == UNMATCHED]
    assert [line.get_marker() for line in grey] == ["o", "x"]
    np.testing.assert_allclose(np.column_stack(grey[0].get_data_3d()), source[4:])  # type: ignore[attr-defined]
    np.testing.assert_allclose(grey[1].get_xydata(), target[4:])


def test_wrong_matches_are_red_and_dashed() -> None:
    source, target = look_at(8, seed=3)
    truth = np.arange(8)
    figure = match_figure(source, target, [1, 0, 2, 3, 4, 5, -1, 7], truth=truth)
    styles = [(to_hex(line.get_edgecolor()).upper(), line.get_linestyle()) for line in lines_of(figure)]
    assert styles.count((WRONG, "--")) == 2
    assert sum(style == "-" for _, style in styles) == 5
    assert "wrong (2)" in legend_texts(figure)
    assert not any("wrong" in text for text in legend_texts(match_figure(source, target, truth, truth=truth)))


def test_each_motion_has_a_colour_and_a_marker() -> None:
    source, target = look_at(10, seed=4)
    motions = np.array([0, 0, 0, 0, 0, 1, 1, 1, 1, -1])
    figure = match_figure(source, target, [*range(9), -1], motions=motions)
    colours = [to_hex(line.get_edgecolor()) for line in lines_of(figure)]
    assert len(set(colours[:5])) == len(set(colours[5:])) == 1
    assert colours[0] != colours[5]
    assert legend_texts(figure)[:2] == ["motion 0 (5)", "motion 1 (4)"]
    named = match_figure(source, target, [*range(9), -1], motions=motions, motion_names=["left", "right"])
    assert legend_texts(named)[:2] == ["left (5)", "right (4)"]
    assert len({line.get_marker() for line in figure.axes[1].lines}) == 3  # two motions and the unmatched


@pytest.mark.parametrize("seed", range(5))
def test_space_is_seen_from_near_the_camera(seed: int) -> None:
    """So that right is right and down is down on both sides, and the lines cross little."""
    source, target = look_at(20, seed)
    figure = match_figure(source, target, np.arange(20))
    left, right = page_places(figure, source, target)
    for coordinate in (0, 1):
        assert np.corrcoef(left[:, coordinate], right[:, coordinate])[0, 1] > 0.8


@pytest.mark.parametrize(
    "assignment",
    [[-1] * 5, [0, -1, -1, -1, -1], [0, 1, 2, 3, 4]],
    ids=["none", "one", "all on a line"],
)
def test_too_little_for_a_view_still_gives_a_picture(assignment: list[int]) -> None:
    source = np.arange(5.0)[:, None] * [1.0, 2.0, 0.0]
    target = np.arange(5.0)[:, None] * [10.0, 0.0]
    figure = match_figure(source, target, assignment)
    figure.canvas.draw()
    assert len(lines_of(figure)) == sum(partner >= 0 for partner in assignment)


def test_names_of_thirty_points_hardly_cover_each_other() -> None:
    source, target = look_at(30, seed=6)
    names = [f"p{index}" for index in range(30)]
    figure = match_figure(source, target, np.arange(30), source_names=names, target_names=names)
    figure.canvas.draw()
    for axes in figure.axes:
        assert [text.get_text() for text in axes.texts] == names
        boxes = [text.get_window_extent().padded(-1.0) for text in axes.texts]
        overlaps = sum(boxes[i].overlaps(boxes[j]) for i in range(30) for j in range(i))
        assert overlaps <= 2


def test_pictures_are_written_in_the_format_of_their_suffix(tmp_path: Path) -> None:
    source, target = look_at(6, seed=7)
    figure = match_figure(source, target, np.arange(6), title="six of six")
    for name, start in [("a.png", b"\x89PNG"), ("b.SVG", b"<?xml"), ("c.pdf", b"%PDF")]:
        save_figure(figure, tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(start)
    for name in ("picture.bmp", "picture", "picture.png.txt"):
        with pytest.raises(InputError, match=r"use \.png, \.svg or \.pdf"):
            check_picture(tmp_path / name)
        with pytest.raises(InputError, match="use "):
            save_figure(figure, tmp_path / name)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.png", "b.SVG", "c.pdf"]


@pytest.mark.parametrize(
    ("source", "target", "assignment"),
    [
        (np.zeros((3, 4)), np.zeros((3, 2)), [0, 1, 2]),
        (np.zeros((3, 3)), np.zeros((3, 4)), [0, 1, 2]),
        (np.zeros((3, 3)), np.zeros((3, 2)), [0, 1]),
        (np.zeros((3, 3)), np.zeros((3, 2)), [0, 1, 3]),
    ],
)
def test_arrays_that_do_not_belong_together_are_refused(source: Floats, target: Floats, assignment: list[int]) -> None:
    with pytest.raises(InputError, match="picture: "):
        match_figure(source, target, assignment)


def test_no_global_state_is_touched() -> None:
    code = (
        "import sys, numpy as np; from rootmatch.report.pictures import match_figure; "
        "assert 'matplotlib' not in sys.modules; "
        "match_figure(np.random.rand(5, 3), np.random.rand(5, 2), range(5)); "
        "assert 'matplotlib.figure' in sys.modules and 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_poses_are_drawn_to_a_scale_that_is_said(tmp_path: Path) -> None:
    """Predicted points, residuals as long as the legend says, the model's axes, and the photograph behind."""
    scene = p3p(3)
    pose, camera = scene.fitted(), scene.problem.camera  # type: ignore[attr-defined]
    imsave(tmp_path / "photo.png", np.zeros((480, 640)), cmap="gray")
    figure = match_figure(
        scene.source, scene.target, scene.assignment, poses=[pose], camera=camera, photo=tmp_path / "photo.png"
    )
    right = figure.axes[1]
    (said,) = [text for text in legend_texts(figure) if text.startswith("residual")]
    factor = float(said.split()[2])
    drawn = np.array([line.get_xydata() for line in right.lines if line.get_color() == RESIDUAL])
    detected = scene.target[scene.assignment]
    np.testing.assert_allclose(drawn[:, 0], pose.predicted)
    np.testing.assert_allclose(drawn[:, 1] - drawn[:, 0], factor * (detected - pose.predicted))
    assert 0.02 < np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=1).max() / np.ptp(scene.target, axis=0).max() <= 0.06
    assert f"RMS {pose.rms:.2g} px" in said
    ends = {text.get_text(): np.array(text.get_position()) for text in right.texts if text.get_text() in "xyz"}
    centre, reach = scene.source.mean(axis=0), scene.source.std(axis=0)
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        end = centre + REACH * np.sqrt((reach**2).mean()) * axis
        np.testing.assert_allclose(ends[name], camera.project(pose.transform(end)))
    assert right.images[0].get_extent() == [-0.5, 639.5, 479.5, -0.5]
    assert right.get_xlim() == (-0.5, 639.5)


def test_poses_in_space_are_drawn_too() -> None:
    scene = point_sets(2, rm.Rigid(3))
    figure = match_figure(scene.source, scene.target, scene.assignment, poses=[scene.fitted()])
    drawn = [line for line in figure.axes[1].lines if line.get_color() == RESIDUAL]
    assert len(drawn) == len(scene.source)


def test_a_flat_model_has_both_ends_on_its_thin_axis() -> None:
    source, target = look_at(12, 0)
    figure = match_figure(source * [1.0, 1.0, 0.1], target, np.arange(12))
    assert len(figure.axes[0].get_zticks()) == 2
