"""
Several objects that move
=========================

Matching does not assume that all points share one transformation: hyper-edges agree within each rigid object, and a
packing of groups separates the objects.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np

import rootmatch as rm
from rootmatch.report.pictures import match_figure
from rootmatch.simulation import up2p_scene

scene = up2p_scene(
    n=15, outliers=5, noise=0.5, seed=7, motions=3
)  # three objects of five points, five false detections

# %%
# The vertical is known (``UP2P``), and nobody says how many objects there are.
match = rm.match(scene.source, scene.target, scene.problem, noise=scene.noise, motions="auto")
print(match.advice)
print(f"{match.motion_labels.max() + 1} motions found, {scene.accuracy(match.assignment):.0%} of the points right")
for label in range(match.motion_labels.max() + 1):
    members = np.flatnonzero(match.motion_labels == label)
    print(f"motion {label}: points {members.tolist()}, truly of object {sorted(set(scene.motions[members].tolist()))}")

# %%
figure = match_figure(scene.source, scene.target, match.assignment, motions=match.motion_labels, truth=scene.truth)
plt.figure(figure)
plt.show()
