"""
LEDs of a headset
=================

Thirty-two identical LEDs on a headset, half of them on the far side, seen by one calibrated camera among reflections.
Nothing distinguishes the blobs; the outward normals of the LEDs say which of them can be visible together.
"""

# %%
# The model: LEDs on the front and the rim of a visor, in metres, each with the direction in which it shines.
import matplotlib.pyplot as plt
import numpy as np

import rootmatch as rm
from rootmatch.report.pictures import match_figure

rng = np.random.default_rng(5)
azimuth, height = rng.uniform(-np.pi, np.pi, 32), rng.uniform(-0.05, 0.05, 32)
normals = np.column_stack([np.sin(azimuth), 2.0 * height, np.cos(azimuth)])
normals += 0.2 * rng.normal(size=normals.shape)
normals /= np.linalg.norm(normals, axis=1, keepdims=True)
model = np.column_stack([0.1 * np.sin(azimuth), height, 0.08 * np.cos(azimuth)])
model += 0.004 * rng.normal(size=(32, 3))

# %%
# One frame, simulated: the headset 60 cm in front of the camera, 0.3 px of noise, six reflections.
camera = rm.Camera(fx=700, fy=700, cx=640, cy=480)
angle = np.deg2rad(155.0)
c, s = np.cos(angle), np.sin(angle)
R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
t = np.array([0.05, -0.02, 0.6])
in_camera = model @ R.T + t
towards = -in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)
facing = ((normals @ R.T) * towards).sum(axis=1)
visible = np.flatnonzero(facing > np.cos(np.deg2rad(70.0)))
blobs = camera.project(in_camera[visible]) + 0.3 * rng.normal(size=(len(visible), 2))
reflections = rng.uniform((500, 400), (800, 560), (6, 2))
image = np.vstack([blobs, reflections])
order = rng.permutation(len(image))
image = image[order]
truth = np.full(32, -1)
truth[visible] = np.argsort(order)[: len(visible)]

# %% Match. A :class:`rootmatch.Matcher` keeps whatever depends only on the model for the next frames.
matcher = rm.Matcher(model, rm.P3P(camera), noise=0.3, normals=normals)
match = matcher.match(image)
print(match.advice)
found = match.assignment >= 0
right = np.sum(found & (match.assignment == truth))
print(f"{len(visible)} LEDs visible: {right} right, {found.sum() - right} wrong")

# %%
figure = match_figure(model, image, match.assignment, truth=truth, unit="m")
plt.figure(figure)
plt.show()
