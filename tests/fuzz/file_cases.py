"""Files as anybody may hand them over: good ones of every kind, what is done to them, and what must hold afterwards."""

from __future__ import annotations

import itertools
import random
import struct
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from call_cases import check_text

import rootmatch as rm
from rootmatch.cameras.base import CameraModel
from rootmatch.io import PointSet, read_camera, read_candidates, read_points, read_truth
from rootmatch.io.frame_files import Frame, read_frames
from rootmatch.io.pose_files import read_prior

MODEL = b"id,x,y,z,nx,ny,nz\n" + b"".join(b"led %d,%d,%d.5,-1e%d,0,0,1\n" % (k, k, k * k, k) for k in range(6))
IMAGE = b"x,y\r\n" + b"".join(b"%d.25,%d\r\n" % (300 + 17 * k, 200 + 5 * k * k) for k in range(7))
SOURCE = PointSet(np.arange(18.0).reshape(6, 3), tuple(f"led {k}" for k in range(6)))
TARGET = PointSet(np.arange(14.0).reshape(7, 2))

OPENCV_YAML = b"""%YAML:1.0
---
image_width: 1280
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1000., 0., 640., 0., 1010., 480., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.28, 0.07, 1.0e-03, -2.0e-03, 0.01 ]
"""
OPENCV_XML = b"""<?xml version="1.0"?>
<opencv_storage>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>1000. 0. 640. 0. 1010. 480. 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>1</rows><cols>5</cols><dt>d</dt>
  <data>-0.28 0.07 1.0e-03 -2.0e-03 0.01</data></distortion_coefficients>
</opencv_storage>
"""
KALIBR = b"""cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [1000.0, 1010.0, 640.0, 480.0]
  resolution: [1280, 960]
cam1:
  camera_model: pinhole
  distortion_coeffs: [0.05, -0.02, 0.003, -0.0005]
  distortion_model: equidistant
  intrinsics: [1000.0, 1010.0, 640.0, 480.0]
"""
ROS = b"""image_width: 1280
image_height: 960
camera_name: narrow_stereo
camera_matrix: {rows: 3, cols: 3, data: [1000.0, 0, 640.0, 0, 1010.0, 480.0, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.28, 0.07, 0.001, -0.002, 0.01]}
"""
COLMAP = b"""# Camera list
1 PINHOLE 1280 960 1000 1010 640 480
2 OPENCV_FISHEYE 1280 960 1000 1010 640 480 0.05 -0.02 0.003 -0.0005
"""
COLMAP_BINARY = struct.pack("<QIiQQ4d", 1, 1, 1, 1280, 960, 1000.0, 1010.0, 640.0, 480.0)
OWN = b"""{"fx": 1000, "fy": 1010.0, "cx": 640, "cy": 480, "dist": [-0.28, 0.07, 0.001, -0.002, 0.01],
 "camera2": {"K": [[900, 0, 320], [0, 901, 240], [0, 0, 1]], "fisheye": [0.05, -0.02, 0.003, -0.0005]},
 "vertical_camera": [0, 1, 0], "vertical_world": [0.0, -0.0, 1e0], "axis": [1, 2, 3]}
"""
MARKED = b"id,body,x,y,z,nx,ny,nz\n" + b"".join(
    b"led %d,%s,%d.5,%d,0,0,0,1\n" % (k, (b"left", b"right")[k % 2], k, k * k) for k in range(8)
)
FRAMES = b"frame,x,y\n" + b"".join(b"%d,%d.25,%d\n" % (k // 4, 300 + 17 * k, 200 + k * k) for k in range(12))
POSE = b"""{"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [0.0, 0.1, 2.0], "covariance":
 [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0],
  [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1e-4]]}
"""
TIMES = b"frame,time,x,y,sigma\n3,.25,1,2,.5\n3,.25,4,5,1\n\n4,.3,,,\n9,1e1,5,6,2\n\n"
PAIRS = b"source,target,weight\nled 0,3,1\nled 1,2,0.5\nled 5,6,1e3\n"

Reader = Callable[[Path], Any]
KINDS: dict[str, tuple[str, bytes, Reader]] = {
    "model": ("model.csv", MODEL, lambda path: read_points(path, 3, 4)),
    "image": ("image.csv", IMAGE, lambda path: read_points(path, 2, 4)),
    "truth": ("truth.csv", b"source,target\nled 0,3\nled 2,\n", lambda path: read_truth(path, SOURCE, TARGET)),
    "candidates": ("candidates.csv", PAIRS, lambda path: read_candidates(path, SOURCE, TARGET)),
    "camera": ("camera.json", OWN, read_camera),
    "own": ("cameras.json", b'{"cameras": {"left": ' + OWN + b"}}", rm.read_cameras),
    "opencv yaml": ("calibration.yml", OPENCV_YAML, rm.read_cameras),
    "opencv xml": ("calibration.xml", OPENCV_XML, rm.read_cameras),
    "kalibr": ("camchain.yaml", KALIBR, rm.read_cameras),
    "kalibr, one": ("camchain.yaml", KALIBR, lambda path: read_camera(path, "cam1")),
    "ros": ("ros.yaml", ROS, rm.read_cameras),
    "colmap": ("cameras.txt", COLMAP, rm.read_cameras),
    "bodies": ("bodies.csv", MARKED, lambda path: read_points(path, 3, 4)),
    "frames": ("frames.csv", FRAMES, lambda path: list(read_frames(path))),
    "times": ("times.csv", TIMES, lambda path: list(read_frames(path))),
    "prior": ("prior.json", POSE, lambda path: read_prior(path, False)),
    "priors": ("priors.json", b'{"left": ' + POSE + b', "right": ' + POSE + b"}", lambda path: read_prior(path, True)),
    "colmap binary": ("cameras.bin", COLMAP_BINARY, rm.read_cameras),
}
"""Name, content and reader of a good file of every kind."""

PIECES: tuple[bytes, ...] = (
    b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3\x28", "é".encode("latin-1"), "é".encode("utf-16"),
    "\u202e\u200b".encode(), "\U0001f600".encode(), "\u0085\u2028".encode(), b"\x1b[31m\x1b]0;owned\x07", b"\x1b[2J",
    b"\x08\x08", b"[red]", b"[/]", b"<script>alert(1)</script>", b"<svg onload=x>", b"=1+1", b"$x^2$", b"\\n",
    b"%s%n", b"{}", b"{0.__class__}", b",", b";", b"\t", b"|", b'"', b"'", b'""', b"\n", b"\r", b"\r\n", b"\n\n\n",
    b" ", b"#", b":", b"- ", b"---\n", b"...\n", b"nan", b"inf", b"-inf", b"1e400", b"-1e400", b"1e-400", b"0x10",
    b"1_000", "\u0661\u0662".encode(), b"1,5", b"-0", b"+1", b"9" * 400, b"9" * 5000, b"1e999999999999", b"true",
    b"null", b"~", b"None", b"[" * 5000, b"{" * 3000, b"[0, " * 3000, b"- " * 3000, b"<a>" * 2000, b"&a &b *a *b",
    b"&x [*x, *x]", b"<<: *x\n", b"!!python/object/apply:os.system ['true']", b"!!python/name:os.system",
    b"!!binary aGk=", b"!!opencv-matrix", b"? ", b"<!DOCTYPE a [<!ENTITY b 'cc'>]>", b"&b;",
    b"<!DOCTYPE a [<!ENTITY b SYSTEM 'file:///etc/passwd'>]>", b"a" * 20000, b"a,b,c\n" * 2000, b"id", b"source",
    b"target", b"weight", b"x", b"y", b"z", b"nx", b"K", b"fx", b"dist", b"camera_matrix", b"rows", b"data",
    b"cameras", b"-1", b"0", b"1e308", b"led 0",
)  # fmt: skip
"""What is put into files: markup, escapes, quotes, encodings, numbers and nesting that break readers."""

DEEDS = (
    "put", "put", "put", "replace", "cut", "end", "twice", "flip", "byte", "swap", "encode", "line", "word", "word",
)  # fmt: skip


def recipe(rng: random.Random, kinds: tuple[str, ...] = tuple(KINDS)) -> dict[str, Any]:
    """A recipe of a file: the kind, and what is done to a good one, each deed at a place and with a piece."""
    deeds = [
        [rng.choice(DEEDS), rng.randint(0, 999), rng.randint(0, 60), rng.randrange(len(PIECES))]
        for _ in range(rng.randint(1, 4))
    ]
    return {"kind": rng.choice(kinds), "deeds": deeds}


def simpler(recipe: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Recipes with one deed less each, or a shorter one."""
    deeds = recipe["deeds"]
    for k, (deed, place, length, piece) in enumerate(deeds):
        if len(deeds) > 1:
            yield {**recipe, "deeds": deeds[:k] + deeds[k + 1 :]}
        if length > 0:
            yield {**recipe, "deeds": [*deeds[:k], [deed, place, length // 2, piece], *deeds[k + 1 :]]}


def content_of(recipe: dict[str, Any]) -> bytes:
    """The bytes of the file."""
    data = KINDS[recipe["kind"]][1]
    for deed, place, length, number in recipe["deeds"]:
        at, piece = place * len(data) // 999, PIECES[number]
        if deed == "put":
            data = data[:at] + piece + data[at:]
        elif deed == "replace":
            data = data[:at] + piece + data[at + length :]
        elif deed == "cut":
            data = data[:at] + data[at + length :]
        elif deed == "end":
            data = data[:at]
        elif deed == "twice":
            data = data[: at + length] + data[at:]
        elif deed == "flip":
            data = data[:at] + bytes(b ^ (1 << number % 8) for b in data[at : at + 1]) + data[at + 1 :]
        elif deed == "byte":
            data = data[:at] + bytes([(7 * number + length) % 256]) + data[at + 1 :]
        elif deed == "swap":
            data = data[:at] + data[at + length : at + 2 * length] + data[at : at + length] + data[at + 2 * length :]
        elif deed == "encode":
            text = data.decode("utf-8", "replace")
            data = text.encode(("utf-16", "utf-32-le", "utf-7", "cp037", "latin-1")[number % 5], "replace")
        elif deed == "line":
            lines = data.split(b"\n")
            which = place % len(lines)
            lines[which : which + 1] = [lines[which]] * (number % 3)
            data = b"\n".join(lines)
        elif deed == "word":  # a whole value or name, and so one that is still of the format
            words = data.replace(b"\n", b" \n ").replace(b",", b" , ").replace(b"]", b" ] ").split(b" ")
            full = [k for k, word in enumerate(words) if word.strip(b"\n,][{}:")]
            if full:
                words[full[place % len(full)]] = piece
            data = b" ".join(words)
        data = data[:200_000]
    return data


def attempt(recipe: dict[str, Any]) -> Any:
    """Read the file and check what comes of it; None where it was refused by one `InputError`."""
    name, _, reader = KINDS[recipe["kind"]]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content_of(recipe))
        try:
            found = reader(path)
        except rm.InputError as error:
            check_text(str(error).replace(str(path), name))
            return None
    if isinstance(found, PointSet):
        assert np.all(np.isfinite(found.points))
        labels = found.bodies or ("",) * len(found.points)
        assert len({(label, *point) for label, point in zip(labels, found.points.tolist(), strict=True)}) == len(labels)
        assert found.normals is None or np.all(np.isfinite(found.normals))
        assert len(set(found.names)) == len(found.points)
        assert all(name.isprintable() for name in (*found.names, *labels))
    elif isinstance(found, np.ndarray):
        assert np.all(np.isfinite(found))
    elif isinstance(found, list):
        assert all(isinstance(frame, Frame) and np.all(np.isfinite(frame.points)) for frame in found)
        numbers = [frame.number for frame in found]
        assert all(0 <= one < other < 2**63 for one, other in itertools.pairwise([*numbers, numbers[-1] + 1]))
    elif "prior" in recipe["kind"]:
        for pose in found.values() if isinstance(found, dict) else [found]:
            np.testing.assert_allclose(pose.R @ pose.R.T, np.eye(3), atol=1e-9)
            assert np.all(np.isfinite(pose.t))
            assert np.all(np.linalg.eigvalsh(pose.covariance) > -1e-5 * np.abs(pose.covariance).max())
    else:
        cameras = found.values() if isinstance(found, dict) else [found.camera, found.camera2 or found.camera]
        for camera in cameras:
            assert isinstance(camera, CameraModel)
            assert np.isfinite(camera.focal)
            hash(camera)
            repr(camera)
            ray = camera.bearings(camera.project(np.array([[0.0, 0.0, 1.0]])))
            np.testing.assert_allclose(ray, [[0.0, 0.0, 1.0]], atol=1e-5)
        assert not isinstance(found, dict) or found
    return found
