"""
Two images and one common direction
===================================

Corners of a façade in two photographs; the vertical is known in both, from an IMU or from the vanishing point of upright
edges. No descriptor is compared: on a façade all windows look alike.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np

import rootmatch as rm
from rootmatch.report.pictures import match_figure

rng = np.random.default_rng(3)
camera = rm.Camera(fx=1000, fy=1000, cx=640, cy=480)

# window corners on a wall with two bays that stand out, in metres; y points down
grid = np.array([(x, y) for x in (-4.0, -1.2, 1.5, 4.2) for y in (-2.0, 0.3, 2.2)])
wall = np.column_stack([grid + rng.uniform(-0.3, 0.3, grid.shape), 14.0 + rng.choice([0.0, -1.5, -2.5], len(grid))])

turn = np.deg2rad(14.0)
R = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
first = camera.project(wall) + 0.3 * rng.normal(size=(len(wall), 2))
second = camera.project(wall @ R.T + (-3.0, 0.4, 0.8)) + 0.3 * rng.normal(size=(len(wall), 2))
order = rng.permutation(len(wall))
second, truth = second[order], np.argsort(order)

# %%
# Both cameras are level, so the vertical is the y axis of both.
problem = rm.ThreePlusOne(camera, camera, axis=(0, 1, 0), axis2=(0, 1, 0))
match = rm.match(first, second, problem, noise=0.3)
print(match.advice)
print(f"{np.mean(match.assignment == truth):.0%} right; lead over the best other assignment {match.margin:.2f}")

# %%
# Three pairs determine the motion up to a few solutions; each further pair constrains it only once, as a point in one
# view corresponds to a line in the other. Points near the same epipolar line may therefore be exchanged; the
# alternatives say which.
for other, score in match.alternatives[:3]:
    changed = np.flatnonzero(other != match.assignment)
    print(f"score {score:.1f} instead of {match.score:.1f}: other images for points {changed.tolist()}")

# %%
figure = match_figure(first, second, match.assignment, truth=truth)
plt.figure(figure)
plt.show()
