"""
A problem of your own
=====================

State the equation that relates the measurements of a point; :func:`rootmatch.derive` eliminates the unknowns, finds the
polynomial that minimal sets share, and compiles the residual. In this example, a robot on a flat floor takes two
pictures.
"""

# %%
# Between the pictures it has rotated by θ about the vertical and moved by (tx, 0, tz). With x = tan(θ/2), rays p and q of
# one point satisfy q · (t × R p) = 0. Nothing else has to be stated.
import matplotlib.pyplot as plt
import numpy as np
import sympy as sp

import rootmatch as rm
from rootmatch.report.pictures import match_figure

camera = rm.Camera(600, 600, 320, 240)
x, tx, tz = sp.symbols("x tx tz")
R = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])
t = sp.Matrix([tx, 0, tz])
floor = rm.derive(
    "floor",
    each=lambda p, q: q.dot(t.cross(R * p)),
    minimal=2,
    shared=x,
    eliminate=[tx, tz],
    source=rm.Bearings(camera),
    target=rm.Bearings(camera),
)
print(f"degree {floor.degree}, hyper-edges of {floor.order} points")

# %%
# Two noisy pictures, the second in another order.
rng = np.random.default_rng(2)
points = rng.uniform((-4, -2, 5), (4, 2, 12), (12, 3))
c, s = np.cos(0.3), np.sin(0.3)
moved = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + (0.4, 0, 0.9)
order = rng.permutation(12)
first = camera.project(points) + 0.1 * rng.normal(size=(12, 2))
second = (camera.project(moved) + 0.1 * rng.normal(size=(12, 2)))[order]
truth = np.argsort(order)

match = rm.match(first, second, floor, noise=0.1)
print(f"{np.mean(match.assignment == truth):.0%} right; {match.advice}")

# %%
figure = match_figure(first, second, match.assignment, truth=truth)
plt.figure(figure)
plt.show()
