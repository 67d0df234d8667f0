"""The perspective three-point problem from three cosine laws: state, derive, match."""

import sympy as sp

import rootmatch as rm
from rootmatch.simulation import p3p_scene

a, b, c, x = sp.symbols("a b c x")


def cosine_laws(X, u):
    """Equations of the depths a, b, c of three points X observed along the rays u, and the ratio of the first two."""

    def law(i, j, s, t):
        return s**2 + t**2 - 2 * s * t * u[i].dot(u[j]) - (X[i] - X[j]).dot(X[i] - X[j])

    return [law(0, 1, a, b), law(1, 2, b, c), law(2, 0, c, a), b - x * a]


def main() -> int:
    scene = p3p_scene(n=10, outliers=3, noise=0.5, seed=4)
    problem = rm.derive(
        "cosine-laws",
        cosine_laws,
        minimal=3,
        shared=x,
        eliminate=[a, b, c],
        source=rm.Points(3),
        target=rm.Bearings(scene.cameras[0]),
        interval=(0, None),
    )
    print(f"a polynomial of degree {problem.degree}, {problem.constraints} constraints for {problem.order} points")
    match = rm.match(scene.source, scene.target, problem, noise=scene.noise)
    print(f"{scene.accuracy(match.assignment):.0%} of the points right; {match.advice}")
    return 0 if scene.accuracy(match.assignment) == 1.0 else 1


if __name__ == "__main__":
    raise SystemExit(main())
