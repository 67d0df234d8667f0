"""From detections to poses and an animated picture: ``python track.py recording poses.csv flight.gif``."""

import sys
from pathlib import Path

import matplotlib.animation as animation
import matplotlib.pyplot as plt
import numpy as np

import rootmatch as rm
from rootmatch.io import read_camera, read_points

folder, poses, picture = (Path(name) for name in sys.argv[1:])
camera, model = read_camera(folder / "camera.json").camera, read_points(folder / "model.csv", 3)
rows = np.loadtxt(folder / "frames.csv", delimiter=",", skiprows=1)
tracker = rm.Tracker(
    model.points, rm.P3P(camera), noise=0.4, normals=model.normals, view_angle=np.radians(65.0), bodies=model.bodies
)
shown = []
with poses.open("w") as file:
    print("frame,body,status,tx,ty,tz,qx,qy,qz,qw", file=file)
    for frame in np.unique(rows[:, 0]):
        target = rows[rows[:, 0] == frame, 1:]
        match = tracker.update(target, time=frame / 60.0)
        for label, body in match.bodies.items():
            pose = body.poses[0] if body.status else None
            cells = ["", "", "", "", "", "", ""] if pose is None else [*pose.t, *pose.quaternion]
            print(int(frame), label, body.status.name.lower(), *cells, sep=",", file=file)
        shown.append((target, [target[body.assignment[body.assignment >= 0]] for body in match.bodies.values()]))
figure, axes = plt.subplots(figsize=(5, 3.75))
axes.set(xlim=(0, 1280), ylim=(960, 0), aspect="equal")
marks = [axes.plot([], [], form)[0] for form in ("k.", "C0o", "C1o")]
draw = lambda k: [mark.set_data(*part.T) for mark, part in zip(marks, [shown[k][0], *shown[k][1]])]  # noqa: B905, E731
animation.FuncAnimation(figure, draw, range(0, len(shown), 6)).save(picture, writer="pillow", fps=10)
