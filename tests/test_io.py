"""Files in and out: what is written is read back to the bit, and every bad input is named by file and row."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.io import (
    Calibration,
    PointSet,
    check_output,
    parse_camera,
    read_camera,
    read_candidates,
    read_points,
    read_truth,
    write_atomically,
    write_camera,
    write_folder_atomically,
    write_matches,
    write_points,
    write_table,
)
from rootmatch.io.camera_files import parse_direction
from rootmatch.io.point_files import point_dimension

finite = st.floats(allow_nan=False, allow_infinity=False)
# What a reader may count on: printable, with no space at either end.
identifier = st.text(min_size=1, max_size=12).filter(lambda text: text == text.strip() and text.isprintable())


@st.composite
def point_sets(draw: st.DrawFn) -> PointSet:
    dimension = draw(st.sampled_from([2, 3]))
    count = draw(st.integers(1, 8))
    rows = draw(st.lists(st.tuples(*[finite] * dimension), min_size=count, max_size=count, unique=True))
    ids = draw(st.none() | st.lists(identifier, min_size=count, max_size=count, unique=True))
    normals = None
    if dimension == 3 and draw(st.booleans()):
        normals = draw(arrays(float, (count, 3), elements=st.floats(0.1, 1.0)))
    return PointSet(np.array(rows), None if ids is None else tuple(ids), normals)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(points=point_sets())
@example(points=PointSet(np.array([[5e-324, -0.0], [1.7976931348623157e308, 0.1]]), ('a,"b"', "=1+1;\u00e9")))
def test_points_are_read_back_to_the_bit(tmp_path: Path, points: PointSet) -> None:
    path = tmp_path / "points.csv"
    write_points(path, points)
    back = read_points(path, points.points.shape[1])
    assert back.points.tobytes() == points.points.tobytes()
    assert back.ids == points.ids
    if points.normals is None:
        assert back.normals is None
    else:
        assert back.normals is not None
        assert back.normals.tobytes() == points.normals.tobytes()
    assert [file.name for file in tmp_path.iterdir()] == ["points.csv"]


@pytest.mark.parametrize(
    "content",
    [
        b"x,y\n1,2\n3,4\n",
        b"\xef\xbb\xbfx,y\r\n1,2\r\n3,4\r\n",
        b"\n \ny , X\n2,1\n\n \n 4 ,3.0",
        b'"x","y"\r"1","2"\r"3","4e0"\r',
        b'x, "y"\n"1", "2"\n3, 4\n',
        b"# x,y\n1.000000000000000000e+00,2.000000000000000000e+00\n3,4\n",
    ],
    ids=[
        "plain",
        "byte-order mark and CRLF",
        "blank lines, spaces, other order",
        "quotes and old Mac line ends",
        "quotes after spaces",
        "a header after #, as of numpy.savetxt",
    ],
)
def test_tolerated_writings(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "image.csv"
    path.write_bytes(content)
    points = read_points(path, 2)
    np.testing.assert_array_equal(points.points, [[1.0, 2.0], [3.0, 4.0]])
    assert points.ids is None
    assert points.names == ("0", "1")


@pytest.mark.parametrize(
    ("dimension", "content", "row", "words"),
    [
        (2, "", None, "empty"),
        (2, " \n\n", None, "empty"),
        (2, "x,y\n\n", None, "no row follows"),
        (2, "x\n1\n", 1, "'y' is missing"),
        (3, "x,y\n1,2\n", 1, "swapped"),
        (2, "x,y,z\n1,2,3\n", 1, "swapped"),
        (2, "x [px],y (px)\n1,2\n", 1, "'x' is missing, the header must name x,y; rename 'x [px]' to x?"),
        (2, "x,y,camera\n1,2,0\n", 1, "'camera' is unknown; known columns are id, x, y"),
        (2, "x,y,colour\n1,2,3\n", 1, "'colour' is unknown; known columns are id, x, y, sigma; remove it"),
        (2, "x,y,sigmas\n1,2,3\n", 1, "rename 'sigmas' to sigma?"),
        (2, "u,v\n1,2\n", 1, "rename 'u' to x?"),
        (2, "x,y,x\n1,2,3\n", 1, "'x' is named twice"),
        (2, "x;y\n1,5;2,5\n", 1, "semicolons"),
        (2, "x\ty\n1\t2\n", 1, "tabs"),
        (2, "1,2\n3,4\n", 1, "add a header row x,y"),
        (2, "1e0 2e0\n3e0 4e0\n", 1, "spaces between the columns; save with commas under a header row x,y"),
        (2, "# x y\n1 2\n", 1, "spaces between the columns; save with commas, and"),
        (2, "# x,y\n1 2\n", 2, "spaces between the columns; save with commas, and"),
        (2, "x,y\n1,2\n3;4\n", 3, "semicolons between the columns"),
        (2, "# x,z\n1,2\n", 1, "start with a header x,y"),
        (3, "# x,y\n1,2\n", 1, "'z' is missing"),
        (2, "x,y\n1,2\n3,abc\n", 3, "y is 'abc'"),
        (2, "x,y\n1,2\n\n1_0,4\n", 4, "x is '1_0'"),
        (2, "x,y\n1,\n", 2, "y is empty"),
        (2, "x,y\n1,2\n,\n3,4\n", 3, "a row of commas without values; fill it, or remove it"),
        (2, "x,y\n1,2\n3,4\n \n , \n", 5, "a row of commas without values"),
        (2, "\n,\nx,y\n1,2\n3,4\n", 2, "a row of commas without values"),
        (3, 'x,y,z\n1,2,3\n"",,\n4,5,6\n', 3, "a row of commas without values"),
        (2, "x,y\n1,nan\n", 2, "finite"),
        (2, "x,y\n-Inf,1\n", 2, "finite"),
        (2, "x,y\n1,2\n1,2,3\n", 3, "3 values given, 2 expected"),
        (2, "x,y\n1,2\n7\n", 3, "1 values given, 2 expected"),
        (2, "id,x,y\na,1,2\nb,3,4\na,5,6\n", 4, "the same id as in row 2"),
        (2, "id,x,y\n,1,2\n", 2, "id is empty"),
        (2, 'id,x,y\n"a\tb",1,2\n', 2, "line break"),
        (2, "x,y\n1,2\n3,4\n1.0,2.0\n", 4, "the same point as in row 2"),
        (2, 'x,y\n"1,2\n', 2, "quotes"),
        (2, "# by a detector\nx,y\n1,2\n", 1, "remove the lines that begin with #"),
        (2, "x,y,\n1,2,\n", 1, "a column without a name"),
        (3, "x,y,z,nx,ny\n1,2,3,0,0\n", None, "column nz is missing"),
        (3, "x,y,z,sx,sz\n1,2,3,0,0\n", None, "column sy is missing although sx is given; give sx,sy,sz or none"),
        (3, "x,y,z,sigma,sx,sy,sz\n1,2,3,0,0,0,0\n", None, "it has columns sigma and sx; give only one"),
        (3, "x,y,z,sx,sy,sz\n1,2,3,0,0,-1\n", 2, "sz is '-1'; give a number of 0 or more"),
        (3, "x,y,z,nx,ny,nz\n1,2,3,,0,1\n", 2, "nx is empty; give it, or leave all of nx,ny,nz empty"),
        (3, "x,y,z,nx,ny,nz\n1,2,3,0,,\n", 2, "ny is empty; give it, or leave all of nx,ny,nz empty"),
        (2, "x,y\n1,2\n", None, "1 given and at least 2 needed"),
    ],
)
def test_bad_points_are_named(tmp_path: Path, dimension: int, content: str, row: int | None, words: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(content, newline="")
    with pytest.raises(InputError) as caught:
        read_points(path, dimension, minimum=2)
    text = str(caught.value)
    assert text.startswith(f"{path}, row {row}: " if row else f"{path}: ")
    assert words in text
    assert "\n" not in text


def test_a_normal_may_be_unknown(tmp_path: Path) -> None:
    """By three zeros, as in Python, or three empty cells; what is written is read back."""
    (tmp_path / "model.csv").write_text("x,y,z,nx,ny,nz\n1,2,3,0,0,0\n3,4,5,,,\n5,6,7,0,1,0\n")
    points = read_points(tmp_path / "model.csv", 3)
    assert points.normals is not None
    assert points.normals.tolist() == [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    write_points(tmp_path / "again.csv", points)
    again = read_points(tmp_path / "again.csv", 3)
    assert again.normals is not None
    assert again.normals.tolist() == points.normals.tolist()


def test_a_detection_may_be_repeated(tmp_path: Path) -> None:
    (tmp_path / "image.csv").write_text("x,y\n1,2\n3,4\n1,2\n")
    assert len(read_points(tmp_path / "image.csv", 2, of_image=True).points) == 3


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_points(tmp_path / "missing.csv", 2)
    with pytest.raises(InputError, match="is a folder"):
        read_points(tmp_path, 2)
    (tmp_path / "utf16.csv").write_bytes("x,y\n1,2\n".encode("utf-16"))
    with pytest.raises(InputError, match="UTF-8"):
        read_points(tmp_path / "utf16.csv", 2)


def test_matches_name_points_by_id_or_by_row_number(tmp_path: Path) -> None:
    source = PointSet(np.zeros((3, 3)), ("tip, left", "base", "ear"))
    target = PointSet(np.zeros((2, 2)))
    path = tmp_path / "matches.csv"
    weights, residuals = np.array([0.5, 0.0, 0.1 + 0.2]), np.array([0.25, np.nan, np.nan])
    write_matches(
        path, np.array([1, -1, 0]), weights=weights, motions=np.array([0, -1, 1]), residuals=residuals,
        confidence=np.array([0.75, 1.0, np.nan]), source=source, target=target,
    )  # fmt: skip
    with path.open(newline="") as stream:
        rows = list(csv.reader(stream))
    assert rows == [
        ["source", "target", "weight", "motion", "residual", "confidence"],
        ["tip, left", "1", "0.5", "0", "0.25", "0.75"],
        ["ear", "0", "0.30000000000000004", "1", "", ""],
    ]
    np.testing.assert_array_equal(read_truth(path, source, target), [1, -1, 0])


def test_a_truth_that_names_no_point_or_one_twice_is_refused(tmp_path: Path) -> None:
    source, target = PointSet(np.zeros((2, 3))), PointSet(np.zeros((2, 2)))
    path = tmp_path / "truth.csv"
    write_table(path, ("source", "target"), [(0, 1), (1, "")])
    np.testing.assert_array_equal(read_truth(path, source, target), [1, -1])
    for rows, words in [
        ([(0, 2)], "row 2: no target point is named '2'"),
        ([(0, 1), (5, 0)], "row 3: no source point is named '5'"),
        ([(0, 1), (1, 1)], "row 3: the same target as in row 2"),
        ([(0, 1), (0, 0)], "row 3: the same source as in row 2"),
    ]:
        write_table(path, ("source", "target"), rows)
        with pytest.raises(InputError, match=words):
            read_truth(path, source, target)


def test_candidates_are_a_mask_or_weights(tmp_path: Path) -> None:
    source, target = PointSet(np.zeros((2, 3)), ("a", "b")), PointSet(np.zeros((3, 2)))
    path = tmp_path / "candidates.csv"
    write_table(path, ("source", "target"), [("a", 2), ("a", 0), ("b", 2)])
    mask = read_candidates(path, source, target)
    assert mask.dtype == np.bool_
    np.testing.assert_array_equal(mask, [[True, False, True], [False, False, True]])
    write_table(path, ("weight", "source", "target"), [(0.5, "a", 2), (2, "b", 0)])
    np.testing.assert_array_equal(read_candidates(path, source, target), [[0.0, 0.0, 0.5], [2.0, 0.0, 0.0]])
    for rows, words in [
        ([(1, "a", 2), (1, "a", 2)], "row 3: the same correspondence as in row 2"),
        ([(-1, "a", 2)], "row 2: weight is '-1'"),
        ([("much", "a", 2)], "row 2: weight is 'much'"),
        ([(1, "c", 2)], "row 2: no source point is named 'c'"),
    ]:
        write_table(path, ("weight", "source", "target"), rows)
        with pytest.raises(InputError, match=words):
            read_candidates(path, source, target)


def test_camera_files(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    whole = Calibration(
        Camera(1000.0, 990.5, 320.0, 0.1), Camera(800.0, 801.0, 1.0, 2.0), axis=np.array([0.0, 0.6, 0.8])
    )
    write_camera(path, whole)
    back = read_camera(path)
    assert back.camera == whole.camera
    assert back.camera2 == whole.camera2
    assert back.axis2 is None
    assert back.vertical_world is None
    np.testing.assert_allclose(back.axis, [0.0, 0.6, 0.8], rtol=0, atol=1e-15)

    path.write_text(
        json.dumps({"K": [[900, 0, 5], [0, 901, 6], [0, 0, 1]], "width": 640, "height": 480, "k1": 0.0, "rms": 0.2})
    )
    assert parse_camera(str(path), "--camera").camera == Camera(900.0, 901.0, 5.0, 6.0, size=(640, 480))
    assert parse_camera("900, 901,5,6", "--camera").camera == Camera(900.0, 901.0, 5.0, 6.0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "row 1: not JSON"),
        ("[1000, 1000, 320, 240]", "not a JSON object"),
        ('{"fx": 1000, "fy": 1000, "cx": 320}', "cy is missing"),
        ('{"fx": 0, "fy": 1000, "cx": 320, "cy": 240}', "focal length fx is 0"),
        ('{"fx": NaN, "fy": 1000, "cx": 320, "cy": 240}', "finite"),
        ('{"fx": null, "fy": 1000, "cx": 320, "cy": 240}', "fx is None"),
        ('{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240, "k1": 0.1}', "k1 is given on its own"),
        ('{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240, "distortion": [0, 0.1]}', "4, 5, 8, 12 or 14"),
        ('{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240, "vertical-camera": [0, 1, 0]}', "mean 'vertical_camera'"),
        ('{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240, "axis": [0, 0, 0]}', "length is 0"),
        ('{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240, "axis": "y"}', "three numbers"),
        ('{"fx": 1000, "fy": 1000, "cx": 320, "cy": 240, "camera2": 3}', "not a JSON object"),
        ('{"K": [[900, 0], [0, 901]]}', r"shape \(2, 2\)"),
        ('{"K": [[900, 0, "a"]]}', "not a matrix of numbers"),
    ],
)
def test_bad_camera_files_are_named(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "camera.json"
    path.write_text(content)
    with pytest.raises(InputError, match=words) as caught:
        read_camera(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1000,1000,320", "give 4 finite numbers"),
        ("1000,1000,320,abc", "give 4 finite numbers"),
        ("1000,1000,320,inf", "give 4 finite numbers"),
        ("-1000,1000,320,240", "--camera: focal length fx is -1000"),
        ("1000,0,320,240", "--camera: focal length fy is 0"),
        ("phone", "path of a camera file"),
        ("no-such.json", "no such file"),
        ("x" * 5000, "give 4 finite numbers"),
    ],
)
def test_bad_camera_texts(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_camera(text, "--camera")


def test_directions() -> None:
    np.testing.assert_allclose(parse_direction("0, 3,4", "--axis"), [0.0, 0.6, 0.8])
    for text, words in [("0,0,0", "length is 0"), ("0,1", "give 3 finite"), ("0,1,nan", "give 3 finite")]:
        with pytest.raises(InputError, match=f"--axis: .*{words}"):
            parse_direction(text, "--axis")


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, InputError])
def test_nothing_is_left_when_writing_breaks_off(tmp_path: Path, error: type[BaseException]) -> None:
    kept = tmp_path / "kept.csv"
    kept.write_text("as before")

    def break_off(path: Path) -> None:
        with write_atomically(path) as temporary:
            temporary.write_text("half")
            raise error

    def break_off_folder(path: Path) -> None:
        with write_folder_atomically(path) as folder:
            (folder / "model.csv").write_text("half")
            raise error

    for work, path in [(break_off, tmp_path / "new.csv"), (break_off, kept), (break_off_folder, tmp_path / "scene")]:
        with pytest.raises(error):
            work(path)
    assert [file.name for file in tmp_path.iterdir()] == ["kept.csv"]
    assert kept.read_text() == "as before"


def test_a_full_folder_is_kept_unless_forced(tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    for force in (False, True):
        with write_folder_atomically(scene, force) as folder:
            (folder / "model.csv").write_text(f"force {force}")
        (scene / "notes.txt").write_text("mine")
        with pytest.raises(InputError, match="--force"), write_folder_atomically(scene):
            pytest.fail("a folder that is not empty was opened")
        assert (scene / "model.csv").read_text() == f"force {force}"
    assert sorted(file.name for file in scene.iterdir()) == ["model.csv", "notes.txt"]
    assert [file.name for file in tmp_path.iterdir()] == ["scene"]
    with pytest.raises(InputError, match="is a file"), write_folder_atomically(scene / "notes.txt"):
        pytest.fail("a file was taken for a folder")
    with pytest.raises(InputError, match="does not exist"), write_folder_atomically(tmp_path / "a" / "b"):
        pytest.fail("a folder without a parent was opened")


def test_outputs_are_refused_before_any_work(tmp_path: Path) -> None:
    path = tmp_path / "matches.csv"
    check_output(path, "--output", [tmp_path / "model.csv"])
    with pytest.raises(InputError, match=r"--output: .* is a folder"):
        check_output(tmp_path, "--output")
    with pytest.raises(InputError, match="does not exist"):
        check_output(tmp_path / "missing" / "matches.csv", "--output")
    with pytest.raises(InputError, match="also an input"):
        check_output(path, "--output", [tmp_path / ".." / tmp_path.name / "matches.csv"])


def test_numbers_keep_their_sign_and_size() -> None:
    assert math.copysign(1.0, parse_direction("-0.0,1,0", "--axis")[0]) == -1.0


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("X [mm],Y [mm],Z [mm]\n1,2,3\n", "must name x,y,z"),
        ("1,2,3\n4,5,6\n", "header row x,y,z"),
        ("label,x,y,z\nF0,1,2,3\n", "rename 'label' to id, or to body"),
    ],
)
def test_headers_of_points_in_space_are_told_what_they_lack(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(told)):
        read_points(path, point_dimension(path))
