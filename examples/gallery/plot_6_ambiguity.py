"""
Ambiguity, and what to do about it
==================================

A constellation that looks the same from two sides has two right answers. A matcher should return both and say so.
"""

# %%
# Six LEDs on the corners of a regular hexagon: six turns map it onto itself.
import matplotlib.pyplot as plt
import numpy as np

import rootmatch as rm

angles = np.deg2rad(60.0 * np.arange(6))
hexagon = np.column_stack([0.1 * np.cos(angles), 0.1 * np.sin(angles), np.zeros(6)])  # metres
camera = rm.Camera(fx=900, fy=900, cx=320, cy=240)
tilt = np.deg2rad(35.0)
R = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(tilt), -np.sin(tilt)], [0.0, np.sin(tilt), np.cos(tilt)]])
rng = np.random.default_rng(0)


def image_of(points: np.ndarray) -> np.ndarray:
    """Pixels with 0.3 px of noise."""
    return camera.project(points @ R.T + (0.02, -0.01, 0.8)) + 0.3 * rng.normal(size=(len(points), 2))


symmetric = rm.match(hexagon, image_of(hexagon), rm.P3P(camera), noise=0.3)
print(symmetric.status.name, "-", symmetric.advice)
for other, score in symmetric.alternatives[:5]:
    print("  also possible:", other, f"score {score:.2f}")

# %%
# A seventh LED, off the axis and out of the plane, breaks the symmetry.
marked = np.vstack([hexagon, (0.05, 0.02, 0.04)])
broken = rm.match(marked, image_of(marked), rm.P3P(camera), noise=0.3)
print(broken.status.name, "-", broken.advice)
print("probability of being right:", broken.probability)

# %%
# The score of each match and of its best alternatives: level on the left, a clear lead on the right.
figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
for ax, match, title in zip(axes, (symmetric, broken), ("hexagon", "hexagon and one more"), strict=True):
    scores = [match.score, *(score for _, score in match.alternatives[:7])]
    ax.bar(range(len(scores)), np.array(scores) / match.score, color=["#0072B2", *["#b8c0c8"] * 7][: len(scores)])
    ax.set(title=f"{title}: {match.status.name.lower()}", xlabel="assignment, the best first")
axes[0].set_ylabel("score, relative")
plt.show()
