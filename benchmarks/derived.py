"""Speed of derived problems against the hand-written ones: an exhaustive sweep of the paper's scenes, one thread.

    NUMBA_NUM_THREADS=1 python benchmarks/derived.py [--problems up2p,p3p,3p1] [--kinds qr,qr-both,normalised,joint]

Measures processor time, so that other load matters little. The first call of each compiles.
"""

import argparse
import time

import sympy as sp

from rootmatch.derivation.derive import Bearings, DerivedProblem, Points, derive
from rootmatch.hypergraph.affinity import affinity
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene

x = sp.Symbol("x")
T = sp.Matrix(sp.symbols("tx ty tz"))
ROTATION = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])


def up2p() -> tuple[Scene, DerivedProblem]:
    scene = up2p_scene(n=16, outliers=6, noise=0.5, seed=1)
    equation = lambda X, u: u[0].cross(u[1]).dot(ROTATION * (X[1] - X[0]))  # noqa: E731
    rays = Bearings(scene.cameras[0])
    return scene, derive("up2p", equation, minimal=2, shared=x, source=Points(3), target=rays)


def p3p() -> tuple[Scene, DerivedProblem]:
    scene = p3p_scene(n=10, outliers=5, noise=0.5, seed=1)
    a, b, c = sp.symbols("a b c")

    def laws(X, u):  # type: ignore[no-untyped-def]
        def law(i, j, s, t):  # type: ignore[no-untyped-def]
            return s**2 + t**2 - 2 * s * t * u[i].dot(u[j]) - (X[i] - X[j]).dot(X[i] - X[j])

        return [law(0, 1, a, b), law(1, 2, b, c), law(2, 0, c, a), b - x * a]

    rays = Bearings(scene.cameras[0])
    return scene, derive(
        "p3p", laws, minimal=3, shared=x, eliminate=[a, b, c], source=Points(3), target=rays, interval=(0, None)
    )


def three_plus_one() -> tuple[Scene, DerivedProblem]:
    """With depths in front, as the hand-written kernels have it."""
    scene = three_plus_one_scene(n=10, outliers=5, noise=0.5, seed=1, baseline=4.0)
    rays = Bearings(scene.cameras[0])

    def positive(X, u):  # type: ignore[no-untyped-def]
        normals = [(ROTATION * p).cross(q) for p, q in zip(X, u, strict=True)]
        t = normals[0].cross(normals[1])
        depths = []
        for p, q in zip(X, u, strict=True):
            r = ROTATION * p
            depths += [q.cross(t).dot(r.cross(q)), t.cross(r).dot(q.cross(r))]
        return [depths[0] * other for other in depths[1:]]

    each = lambda p, q: q.dot(T.cross(ROTATION * p))  # noqa: E731
    return scene, derive(
        "3p1", each=each, positive=positive, minimal=3, shared=x, eliminate=list(T), source=rays, target=rays
    )


def rate(problem, scene: Scene, name: str) -> float:  # type: ignore[no-untyped-def]
    """Million hyper-edges a second of processor time, the best of four."""
    tables = problem.prepare(scene.source, scene.target, scene.noise)
    weigh = affinity(name)
    kind = weigh.residual.kernel_kind(problem.pair_count)
    best = float("inf")
    for _ in range(5):
        started = time.process_time()
        _, count = exhaustive_tensor(tables, kind, weigh, (len(scene.source), len(scene.target)), problem.order)
        best = min(best, time.process_time() - started)
    return count / best / 1e6


def main() -> None:
    makers = {"up2p": up2p, "p3p": p3p, "3p1": three_plus_one}
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--problems", default=",".join(makers))
    parser.add_argument("--kinds", default="qr,qr-both,normalised,joint")
    options = parser.parse_args()
    print("million hyper-edges a second of one thread:")
    print(f"{'problem':8} {'residual':12} {'derived':>8} {'by hand':>8} {'ratio':>6}")
    for name in options.problems.split(","):
        started = time.perf_counter()
        scene, problem = makers[name]()
        taken = time.perf_counter() - started
        for kind in options.kinds.split(","):
            derived, by_hand = rate(problem, scene, kind), rate(scene.problem, scene, kind)
            print(f"{name:8} {kind:12} {derived:8.1f} {by_hand:8.1f} {derived / by_hand:6.2f}", flush=True)
        print(f"{name:8} derivation or load: {taken:.1f} s")


if __name__ == "__main__":
    main()
