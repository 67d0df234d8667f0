"""
From a root to a match
======================

Which image point belongs to which point in space? Three correspondences determine a camera pose up to a few solutions,
the roots of a polynomial. Two triples of right correspondences that have two of them in common therefore have
polynomials that share a *root*. The published method follows from that: it estimates no pose and compares no
descriptors.
"""

# %%
# Two triples, one unknown
# ------------------------
# The perspective three-point problem of a triple abc has the polynomial of degree four in x = b/a, the ratio of two
# distances from the camera. A second triple abd has another polynomial in the same x. If all four correspondences are
# right, both vanish at the true ratio; if the image of d belongs to another point, they do not.
import matplotlib.pyplot as plt
import numpy as np

import rootmatch as rm
from rootmatch.simulation import p3p_scene

scene = p3p_scene(n=8, noise=0.5, seed=4)
problem, truth = scene.problem, scene.truth


def polynomial(points, images):
    """Coefficients of a triple's polynomial, scaled to unit length."""
    c = problem.coefficients(scene.source[[points]], scene.target[[images]])[0]
    return c / np.linalg.norm(c)


a, b, c, d = 0, 1, 2, 3
first = polynomial([a, b, c], truth[[a, b, c]])
right = polynomial([a, b, d], truth[[a, b, d]])
wrong = polynomial([a, b, d], truth[[a, b, 5]])

x = np.linspace(0.85, 1.25, 400)
figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
for ax, other, title in zip(axes, (right, wrong), ("four right correspondences", "the fourth is wrong"), strict=True):
    for coefficients, colour, label in ((first, "#0072B2", "abc"), (other, "#E69F00", "abd")):
        y = np.polyval(coefficients, x)
        ax.plot(x, y / np.abs(y).max(), color=colour, label=label)
        roots = np.roots(coefficients)
        roots = roots[np.abs(roots.imag) < 1e-9].real
        ax.plot(roots, 0 * roots, "o", color=colour, mfc="none")
    ax.axhline(0.0, color="0.7", lw=0.8)
    ax.set(title=title, xlabel="x = b / a", xlim=(x[0], x[-1]), ylim=(-0.04, 0.03))
    ax.legend()
plt.show()

# %% How nearly do they share it? ---------------------------- The resultant of two polynomials vanishes if they share a
# root. The published method takes its size, ∣R₂ₙ,₂ₙ∣ of a QR factorisation of the Sylvester matrix. It has no unit, and
# what counts as small depends on the scene. The residuals ``normalised`` and ``joint`` are divided by the effect of the
# pixel noise on them, so they are numbers of standard deviations, comparable between scenes.
rng = np.random.default_rng(0)
tuples = np.array([rng.permutation(8)[:4] for _ in range(3000)])
images_right = truth[tuples]
images_wrong = np.array([rng.permutation(8)[:4] for _ in range(3000)])
figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for ax, kind in zip(axes, ("qr", "joint"), strict=True):
    good = rm.residuals(scene.source, scene.target, problem, tuples, images_right, kind, noise=0.5)
    bad = rm.residuals(scene.source, scene.target, problem, tuples, images_wrong, kind, noise=0.5)
    bad = bad[np.isfinite(bad)]
    bins = np.geomspace(1e-14, 1e-2, 60) if kind == "qr" else np.linspace(0.0, 12.0, 60)
    ax.hist(np.clip(good, bins[0], bins[-1]), bins, alpha=0.7, label="right", color="#0072B2")
    ax.hist(np.clip(bad, bins[0], bins[-1]), bins, alpha=0.7, label="at random", color="#E69F00")
    ax.set(title=f"residual {kind}", xscale="log" if kind == "qr" else "linear", yscale="log")
axes[1].set_xlabel("standard deviations (the last bin holds all beyond)")
axes[1].legend()
plt.show()

# %% A hypergraph, and its matching ------------------------------ Four correspondences are a *hyper-edge*. The affinity
# exp(−r²/2) of its residual is one entry of a tensor of order four over all correspondences (i, j). The assignment we
# want is the one-to-one set of correspondences with the largest total weight inside it. A wrong hyper-edge may agree by
# chance, but only the right ones agree with one another.
match = rm.match(scene.source, scene.target, problem, noise=0.5)
print(match.tensor)
figure, axes = plt.subplots(1, 2, figsize=(7.5, 3.4), layout="constrained")
axes[0].imshow(match.soft_assignment, cmap="Blues")
axes[0].plot(truth, np.arange(8), "o", mfc="none", mec="#D55E00", ms=14)
axes[0].set(title="soft assignment (rings: the truth)", xlabel="image point", ylabel="point in space")
axes[1].hist(match.tensor.weights, 30, color="#0072B2")
axes[1].set(title="weights of the hyper-edges kept", xlabel="weight", ylabel="count")
plt.show()

# %%
# How far to trust it
# -------------------
# A pose is fitted to the best assignment and to each of its alternatives, and the posterior probability follows from how well they fit
# and how many detections chance would have put there. ``match.status`` is *matched*, *ambiguous* or *untrusted* by one rule.
print(match.status.name, "with probability", match.probability)
print("right:", np.array_equal(match.assignment, truth))
