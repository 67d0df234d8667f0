"""
Retro-reflective targets through a wide lens
============================================

Forty targets without codes on a test field, photographed with a lens that displaces points by tens of pixels near the
edge of the image. The calibration comes from OpenCV; raw pixels are used as they were measured.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np

import rootmatch as rm
from rootmatch.report.pictures import match_figure

K = np.array([[1400.0, 0.0, 960.0], [0.0, 1400.0, 600.0], [0.0, 0.0, 1.0]])
dist = [-0.21, 0.07, 0.0004, -0.0003, -0.01]  # k1, k2, p1, p2, k3, as cv2.calibrateCamera returns them
camera = rm.Camera.from_opencv(K, dist)

rng = np.random.default_rng(8)
field = rng.uniform((-1.2, -0.8, -0.2), (1.2, 0.8, 0.2), (40, 3))  # metres
angle = np.deg2rad(25.0)
c, s = np.cos(angle), np.sin(angle)
R, t = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]), np.array([0.1, 0.0, 2.6])

# %%
# Thirty of the targets are visible, among ten bright spots that are not targets; 0.2 px of noise.
visible = rng.choice(40, 30, replace=False)
spots = rng.uniform((200, 100), (1700, 1100), (10, 2))
pixels = np.vstack([camera.project(field[visible] @ R.T + t), spots]) + 0.2 * rng.normal(size=(40, 2))
order = rng.permutation(40)
pixels = pixels[order]
truth = np.full(40, -1)
truth[visible] = np.argsort(order)[:30]

# %%
# How far the lens moves the detections:
ideal = rm.Camera.from_matrix(K).project(field[visible] @ R.T + t)
moved = np.linalg.norm(pixels[truth[visible]] - ideal, axis=1)
print(f"distortion: {np.median(moved):.0f} px in the median, {moved.max():.0f} px at most")

# %%
match = rm.match(field, pixels, rm.P3P(camera), noise=0.2)
print(match.advice)
found = match.assignment >= 0
right = np.sum(found & (match.assignment == truth))
print(f"{right} of 30 targets right, {found.sum() - right} wrong")

# %%
# If the distortion of the lens is ignored, the same detections agree on nothing:
print(rm.match(field, pixels, rm.P3P(rm.Camera.from_matrix(K)), noise=0.2).status.name)

# %%
figure = match_figure(field, pixels, match.assignment, truth=truth, unit="m")
plt.figure(figure)
plt.show()
