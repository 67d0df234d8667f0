"""
Surgical fiducials: points in space to points in space
======================================================

Eight markers are known in a CT scan. A tracker reports seven points: six of the markers, in no particular order, and a
stray one. The distances between them show which is which, and the rigid motion follows.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np

import rootmatch as rm
from rootmatch.report.pictures import match_figure

rng = np.random.default_rng(11)
planned = rng.uniform(-80.0, 80.0, (8, 3))  # mm, in the frame of the scan

angle = np.deg2rad(40.0)
R = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
visible = rng.permutation(8)[:6]
measured = planned[visible] @ R.T + (350.0, -120.0, 900.0) + 0.3 * rng.normal(size=(6, 3))
stray = measured.mean(axis=0) + np.array([35.0, -50.0, 20.0])
measured = np.vstack([measured, stray])
truth = np.full(8, -1)
truth[visible] = np.arange(6)

# %%
# The plan is exact and the tracker has 0.3 mm of noise per coordinate: ``noise`` takes both as a pair.
match = rm.match(planned, measured, rm.Rigid(), noise=(0.0, 0.3))
print(match.advice)
print("assignment:", match.assignment, "  truth:", truth)

# %%
# The motion from the plan to the tracker, how well the markers fit, and how accurate the motion is.
(pose,) = match.poses
sigma = np.sqrt(np.diag(pose.covariance))
print(f"fiducial registration error {pose.rms:.2f} mm over {len(pose.points)} markers, {pose.rms_sigma:.2f} σ")
print("σ of the rotation (degrees):", np.rad2deg(sigma[:3]).round(3), "  of the translation (mm):", sigma[3:].round(2))

# %%
figure = match_figure(planned, measured, match.assignment, truth=truth, poses=match.poses, unit="mm")
plt.figure(figure)
plt.show()
