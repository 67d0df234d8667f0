"""Draw docs/flight.gif: a headset and a controller, tracked from dots that all look alike (the extra ``test``).

    python docs/make_flight.py

The recording is that of examples/headset. Left are the detections of each frame, right is what `rootmatch.Tracker`
makes of them: every LED keeps its colour as long as it is identified.
"""

from __future__ import annotations

import colorsys
import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont
from scipy.spatial import ConvexHull

import rootmatch as rm
from rootmatch.io import read_camera, read_points

HERE = Path(__file__).resolve().parent
RECORDING = HERE.parent / "examples" / "headset" / "make_recording.py"
RATE, FRAMES, STEP = 60, 300, 4
"""Frames a second, frames in all, and frames from one picture to the next."""
VIEW = np.array([[310.0, 325.0], [1130.0, 745.0]])
"""Least and greatest pixel that is shown."""
FAR = 0.02
"""Error of a position, in metres, that only a wrong match has."""
PANEL, SMOOTH = (520, 266), 2
"""Size of each half; pictures are drawn larger by the second number, then reduced."""
GROUND, DOT, CLUTTER, TEXT = "#0d1117", "#f0f3f6", "#6b7683", "#c9d1d9"
AXES = ("#ff5c5c", "#4cd964", "#5aa2ff")
AXIS = {"headset": 0.07, "controller": 0.05}
"""Length of the drawn axes in metres."""
LINE, RIM = "#3d4b5c", "#30363d"
HUES = 12
"""Colours of LEDs, which repeat beyond that number."""
SHADES = (0.25, 0.5, 0.75, 1.0)
"""Shades of each colour over the ground in the palette, for smooth edges."""


def recording(
    folder: Path,
) -> tuple[rm.Camera, dict[str, tuple[np.ndarray, np.ndarray]], list[np.ndarray], dict[tuple[int, str], np.ndarray]]:
    """Camera, LEDs and normals by body, the detections of each frame, and true positions by frame and body."""
    subprocess.run([sys.executable, RECORDING, folder, "--frames", str(FRAMES)], check=True)
    camera, model = read_camera(folder / "camera.json").camera, read_points(folder / "model.csv", 3)
    labels = np.array(model.bodies)
    bodies = {str(name): (model.points[labels == name], model.normals[labels == name]) for name in AXIS}
    rows = np.loadtxt(folder / "frames.csv", delimiter=",", skiprows=1)
    with (folder / "truth.csv").open(newline="") as file:
        truth = {
            (int(row["frame"]), row["body"]): np.array([float(row[name]) for name in ("tx", "ty", "tz")])
            for row in csv.DictReader(file)
        }
    return camera, bodies, [rows[rows[:, 0] == k, 1:] for k in range(FRAMES)], truth


def on_panel(pixels: np.ndarray) -> np.ndarray:
    """Places of pixels on a panel as it is drawn."""
    return (pixels - VIEW[0]) * (SMOOTH * PANEL[0] / (VIEW[1, 0] - VIEW[0, 0]))


def dot(draw: ImageDraw.ImageDraw, place: np.ndarray, radius: float, colour: str) -> None:
    x, y, r = *place, SMOOTH * radius
    draw.ellipse((x - r, y - r, x + r, y + r), fill=colour)


def hue(k: int) -> str:
    """Colour of an LED, far from that of its neighbours in the list."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in colorsys.hsv_to_rgb(5 * k % HUES / HUES, 0.72, 1.0))


def palette() -> Image.Image:
    """All colours that are drawn, in `SHADES`."""
    drawn = [DOT, CLUTTER, TEXT, LINE, RIM, *AXES, *(hue(k) for k in range(HUES))]
    ground = np.array(ImageColor.getrgb(GROUND))
    shades = [ground + shade * (np.array(ImageColor.getrgb(one)) - ground) for one in drawn for shade in SHADES]
    colours = np.vstack([ground, *shades]).round().astype(np.uint8)
    found = Image.new("P", (1, 1))
    found.putpalette(np.vstack([colours, np.repeat(colours[:1], 256 - len(colours), axis=0)]).tobytes())
    return found


def outline(draw: ImageDraw.ImageDraw, camera: rm.Camera, points: np.ndarray, pose: rm.Pose) -> None:
    """The hull of a body as the pose shows it: the sides that face the camera."""
    hull, moved = ConvexHull(points), pose.transform(points)
    image, outwards = on_panel(camera.project(moved)), hull.equations[:, :3] @ pose.R.T
    for side, out in zip(hull.simplices, outwards, strict=True):
        if out @ moved[side].mean(axis=0) < 0.0:
            corners = [tuple(image[k]) for k in side]
            draw.line([*corners, corners[0]], fill=LINE, width=SMOOTH)


def frame(
    camera: rm.Camera, bodies: dict[str, tuple[np.ndarray, np.ndarray]], detections: np.ndarray, match: rm.Match
) -> Image.Image:
    """Both halves of one picture."""
    large = (SMOOTH * PANEL[0], SMOOTH * PANEL[1])
    given, found = Image.new("RGB", large, GROUND), Image.new("RGB", large, GROUND)
    left, right = ImageDraw.Draw(given), ImageDraw.Draw(found)
    for place in on_panel(detections):
        dot(left, place, 3.2, DOT)
        dot(right, place, 2.0, CLUTTER)
    counts = []
    for name, (points, _) in bodies.items():
        body = match.bodies[name]
        if not body:
            counts.append(f"{name} {body.status.name.lower()}")
            continue
        outline(right, camera, points, body.pose)
        for i, j in body.pairs:
            dot(right, on_panel(detections[j]), 4.2, hue(int(i)))
        ends = np.vstack([np.zeros(3), AXIS[name] * np.eye(3)])
        origin, *tips = on_panel(camera.project(body.pose.transform(ends)))
        for tip, colour in zip(tips, AXES, strict=True):
            right.line([tuple(origin), tuple(tip)], fill=colour, width=2 * SMOOTH)
        counts.append(f"{name} {len(body.pairs)}")
    font = ImageFont.load_default(12 * SMOOTH)
    place = (8 * SMOOTH, 6 * SMOOTH)
    left.text(place, f"In: {len(detections)} dots", font=font, fill=TEXT)
    right.text(place, f"Identified: {', '.join(counts)}", font=font, fill=TEXT)
    both = Image.new("RGB", (2 * PANEL[0] + 6, PANEL[1]), RIM)
    for x, half in ((0, given), (PANEL[0] + 6, found)):
        both.paste(half.resize(PANEL, Image.Resampling.LANCZOS), (x, 0))
    return both


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        camera, bodies, frames, truth = recording(Path(folder))
    points, normals = (np.concatenate([body[k] for body in bodies.values()]) for k in range(2))
    labels = [name for name, (own, _) in bodies.items() for _ in own]
    known = {"normals": normals, "view_angle": np.radians(65.0), "bodies": labels}
    tracker = rm.Tracker(points, rm.P3P(camera), noise=0.4, **known)
    pictures, missed, wrong = [], dict.fromkeys(bodies, 0), dict.fromkeys(bodies, 0)
    for k, detections in enumerate(frames):
        match = tracker.update(detections, time=k / RATE)
        for name, body in match.bodies.items():
            missed[name] += not body
            wrong[name] += bool(body) and bool(np.linalg.norm(body.pose.t - truth[k, name]) > FAR)
        if k % STEP == 0:
            pictures.append(frame(camera, bodies, detections, match))
    first, *rest = (one.quantize(palette=palette(), dither=Image.Dither.NONE) for one in pictures)
    target = HERE / "flight.gif"
    first.save(target, save_all=True, append_images=rest, duration=1000 * STEP // RATE, loop=0, optimize=True)
    print(f"{len(frames)} frames, not matched: {missed}, matched and far off: {wrong}")
    print(f"{target.name}: {target.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
