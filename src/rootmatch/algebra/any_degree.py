"""Roots and least singular values of polynomials of any degree, as straight-line kernels written for that degree.

Quadratics and quartics have their own closed forms (`polynomial`, `sylvester`). For other degrees the text of a kernel
is composed here, every loop over coefficients unrolled, so that it needs no array and runs wherever the others do; the
least singular value alone works on a small array.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from rootmatch.algebra.polynomial import roots_quadratic, roots_quartic
from rootmatch.algebra.sylvester import smallest_singular_value_quadratic, smallest_singular_value_quartic
from rootmatch.jit.decorators import kernel, scalar

ITERATIONS = 60
"""Bound on the steps towards all roots at once; ten are usual. Not tuned."""
NO_INFORMATION = 2.0
"""Reported for a pair with a zero polynomial, which says nothing: above √2, the most |R| of a unit pair reaches."""


def compile_text(text: str, name: str, names: dict[str, Any]) -> Any:
    """The function of that name in a text composed by this package, never one that was read from a file."""
    namespace: dict[str, Any] = {"math": math, "np": np, "__name__": __name__, **names}
    exec(compile(text, f"<composed {name}>", "exec"), namespace)
    return namespace[name]


def coefficient_names(letter: str, degree: int) -> list[str]:
    """Names of the coefficients of a polynomial, highest degree first."""
    return [f"{letter}{k}" for k in range(degree, -1, -1)]


@cache
def make_root_kernel(degree: int) -> Any:
    """Kernel ``(c_k, …, c_0) → k numbers``: the real roots, and the real part of each complex one.

    The caller decides which are close enough to real, by the value there. Where the leading coefficient is the
    smaller end, the reversed polynomial is solved for 1/x.
    """
    if degree == 1:
        return _linear
    if degree == 2:
        return _quadratic
    if degree == 4:
        return _quartic
    return kernel(compile_text(_roots_text(degree), "roots", {}))


@scalar
def _linear(c1, c0):  # type: ignore[no-untyped-def]
    return (-c0 / c1,)


@scalar
def _quadratic(c2, c1, c0):  # type: ignore[no-untyped-def]
    r0, r1, _ = roots_quadratic(c2, c1, c0)
    return r0, r1


@scalar
def _inverse(re, im):  # type: ignore[no-untyped-def]
    """Real part of 1 / (re + i im)."""
    return re / (re * re + im * im)


@kernel
def _quartic(c4, c3, c2, c1, c0):  # type: ignore[no-untyped-def]
    if abs(c4) >= abs(c0):
        r0, r1, r2, r3, _, _ = roots_quartic(c4, c3, c2, c1, c0)
        return r0, r1, r2, r3
    r0, r1, r2, r3, i01, i23 = roots_quartic(c0, c1, c2, c3, c4)
    return _inverse(r0, i01), _inverse(r1, i01), _inverse(r2, i23), _inverse(r3, i23)


def _roots_text(degree: int) -> str:
    """All roots at once by Aberth's iteration in real arithmetic."""
    n = range(degree)
    lines = [f"def roots({', '.join(coefficient_names('c', degree))}):"]
    ends = ", ".join(f"c{k}" for k in range(degree + 1))
    lines += [
        f"    turn = abs(c{degree}) < abs(c0)",
        "    if turn:",
        f"        {ends} = {', '.join(coefficient_names('c', degree))}",
        f"    scale = 1.0 / c{degree}",
    ]
    lines += [f"    a{k} = c{k} * scale" for k in n]
    # monic and |a0| ≤ 1, so the geometric mean of the roots is at most 1
    lines.append(f"    size = max(abs(a0) ** {1.0 / degree!r}, 1e-3)")
    for k in n:
        angle = 2.0 * math.pi * (k + 0.25) / degree
        lines += [f"    x{k} = size * {math.cos(angle)!r}", f"    y{k} = size * {math.sin(angle)!r}"]
    lines += [f"    for _ in range({ITERATIONS}):", "        moved = 0.0"]
    for k in n:
        lines += ["        p, q, u, v = 1.0, 0.0, 0.0, 0.0"]
        for j in range(degree - 1, -1, -1):
            lines += [
                f"        u, v = u * x{k} - v * y{k} + p, u * y{k} + v * x{k} + q",
                f"        p, q = p * x{k} - q * y{k} + a{j}, p * y{k} + q * x{k}",
            ]
        # Newton's step w = f / f', then w / (1 − w Σ 1 / (z − z_j))
        lines += [
            "        s = u * u + v * v",
            "        wr = (p * u + q * v) / s",
            "        wi = (q * u - p * v) / s",
            "        tr = 0.0",
            "        ti = 0.0",
        ]
        for j in n:
            if j != k:
                lines += [
                    f"        dx = x{k} - x{j}",
                    f"        dy = y{k} - y{j}",
                    "        d = dx * dx + dy * dy",
                    "        tr += dx / d",
                    "        ti -= dy / d",
                ]
        lines += [
            "        br = 1.0 - (wr * tr - wi * ti)",
            "        bi = -(wr * ti + wi * tr)",
            "        d = br * br + bi * bi",
            "        mr = (wr * br + wi * bi) / d",
            "        mi = (wi * br - wr * bi) / d",
            "        if s > 0.0 and d > 0.0:",
            f"            x{k} -= mr",
            f"            y{k} -= mi",
            f"            moved = max(moved, (mr * mr + mi * mi) / (x{k} * x{k} + y{k} * y{k} + 1e-30))",
        ]
    lines += ["        if moved < 1e-30:", "            break"]
    for k in n:
        lines += ["    if turn:", f"        x{k} = x{k} / (x{k} * x{k} + y{k} * y{k})"]
    lines.append(f"    return ({', '.join(f'x{k}' for k in n)},)")
    return "\n".join(lines) + "\n"


@cache
def make_singular_value_kernel(degree: int) -> Any:
    """Kernel ``(p_k, …, p_0, q_k, …, q_0) → σ_min`` of the Sylvester matrix of both scaled to unit 2-norm."""
    p, q = coefficient_names("p", degree), coefficient_names("q", degree)
    closed = {2: smallest_singular_value_quadratic, 4: smallest_singular_value_quartic}.get(degree)
    lines = [f"def value({', '.join(p + q)}):"]
    for letter in ("p", "q"):
        squares = " + ".join(f"{letter}{k} * {letter}{k}" for k in range(degree + 1))
        lines.append(f"    norm_{letter} = math.sqrt({squares})")
    lines += [
        "    if not (norm_p > 0.0 and norm_q > 0.0):",
        "        return NO_INFORMATION",
        "    f = 1.0 / norm_p",
        "    g = 1.0 / norm_q",
    ]
    if closed is not None:
        lines.append(f"    return closed({', '.join([f'f * {name}' for name in p] + [f'g * {name}' for name in q])})")
    else:
        lines.append(f"    a = np.zeros(({2 * degree}, {2 * degree}))")
        for row in range(degree):
            for k, (one, other) in enumerate(zip(p, q, strict=True)):
                lines += [
                    f"    a[{row}, {row + k}] = f * {one}",
                    f"    a[{degree + row}, {row + k}] = g * {other}",
                ]
        lines.append("    return least(a)")
    names = {"NO_INFORMATION": NO_INFORMATION, "closed": closed, "least": smallest_singular_value}
    return kernel(compile_text("\n".join(lines) + "\n", "value", names))


@kernel
def smallest_singular_value(a):  # type: ignore[no-untyped-def]
    """Least singular value of the square array ``a``, overwritten, by one-sided Jacobi rotations of its rows."""
    n = a.shape[0]
    for _ in range(40):
        rotated = False
        for i in range(n - 1):
            for j in range(i + 1, n):
                ii, jj, ij = 0.0, 0.0, 0.0
                for k in range(n):
                    ii += a[i, k] * a[i, k]
                    jj += a[j, k] * a[j, k]
                    ij += a[i, k] * a[j, k]
                if ij * ij > 1e-30 * ii * jj:
                    rotated = True
                    tau = (jj - ii) / (2.0 * ij)
                    t = 1.0 / (abs(tau) + math.sqrt(1.0 + tau * tau))
                    t = t if tau >= 0.0 else -t
                    c = 1.0 / math.sqrt(1.0 + t * t)
                    s = c * t
                    for k in range(n):
                        x, y = a[i, k], a[j, k]
                        a[i, k] = c * x - s * y
                        a[j, k] = s * x + c * y
        if not rotated:
            break
    minimum = np.inf
    for i in range(n):
        square = 0.0
        for k in range(n):
            square += a[i, k] * a[i, k]
        minimum = min(minimum, square)
    return math.sqrt(minimum)
