"""
Hypergraph solvers on a tensor of your own
==========================================

For research in graph matching, the affinity tensor is sparse and may have any order, and every solver accepts it. Here
it comes from the angles of triangles; a dense array of order 3 is converted as well.
"""

# %%
# Twenty points in a plane; the target is rotated, scaled, jittered, and has eight outliers.
import matplotlib.pyplot as plt
import numpy as np

import rootmatch as rm
from rootmatch.solvers import SOLVERS, get_solver

rng = np.random.default_rng(1)
source = rng.normal(size=(20, 2))
angle = 0.7
turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
order = rng.permutation(28)
target = np.vstack([1.3 * source @ turn.T + 0.02 * rng.normal(size=(20, 2)), 1.3 * rng.normal(size=(8, 2))])[order]
truth = np.argsort(order)[:20]

# %%
# Hyper-edges: pairs of triangles with the most similar angles (Duchenne et al. 2011).
tensor = rm.AffinityTensor(*rm.invariant_affinities(source, target, "signed-angles", seed=0))
print(tensor)

# %%
# Every solver by its name, on the same tensor.
accuracy = {}
for name in SOLVERS:
    solution = get_solver(name)(tensor, seed=0)
    accuracy[name] = np.mean(solution.assignment == truth)
    print(f"{name:18s} {accuracy[name]:5.0%} right, score {solution.score:10.1f}, converged {solution.converged}")

# %%
figure, ax = plt.subplots(figsize=(7, 3), layout="constrained")
ax.barh(list(accuracy), list(accuracy.values()), color="#0072B2")
ax.set(xlabel="share of the points matched correctly", xlim=(0, 1))
ax.invert_yaxis()
plt.show()

# %%
# A dense array H[a, b, c], with a = i n' + j for the correspondence of source point i with target point j, becomes a tensor
# of the hyper-edges that are not zero.
n, n_target = 4, 4
dense = np.zeros((n * n_target,) * 3)
right = [i * n_target + (i + 1) % n_target for i in range(n)]  # the matching i -> i + 1
for a in right:
    for b in right:
        for c in right:
            if len({a, b, c}) == 3:
                dense[a, b, c] = 1.0
a, b, c = np.nonzero(dense)
kept = (a < b) & (b < c)  # once each: the tensor is symmetric
indices = np.column_stack([a, b, c])[kept]
small = rm.AffinityTensor(indices, dense[a, b, c][kept], (n, n_target))
print("assignment:", get_solver("ascent")(small, seed=0).assignment)
