"""Closed forms for "do two polynomials share a root?", by the Bézout matrix.

Let p and q have degree k. Their Bézout matrix B (k×k, symmetric) holds the coefficients of
(p(x) q(y) − p(y) q(x)) / (x − y) = Σ B_ij xⁱ yʲ. Three facts carry this file:

* Σ_j c_j Σ_i B_ij xⁱ = s(x) p(x) + t(x) q(x) for any c, with s_m = −Σ_j c_j q_{j+m+1} and t_m = Σ_j c_j p_{j+m+1};
* with c the first column of the adjugate of B the left side is the constant det B = ±Res(p, q): the Bézout identity;
* at a common root x, B (1, x, …)ᵀ = 0, so every column of the adjugate is a multiple of (1, x, …, x^{k−1})ᵀ.

The row (s, t) / Res is the last row of the inverse of the Sylvester matrix M = QR, and the last row of
M⁻¹ = R⁻¹ Qᵀ is a unit vector divided by R_{2k,2k}. Hence **|R_{2k,2k}| = |Res| / ‖(s, t)‖₂** with no factorisation.
Scaling p by 1/‖p‖ scales its cofactor s by ‖p‖ relative to Res, so no coefficient is divided: it costs two norms.

The text of each kernel is composed for its degree (`any_degree.compile_text`). It takes and returns plain floats,
highest degree first, has no branch (selects only) and allocates nothing, so that a loop around it vectorises and the
same source runs on a GPU.

Where this differs from QR in float64, measured against rational arithmetic: for random quartics and those of 3P1 it is
the closer of the two (median 3e-17, QR 6e-17; worst 5e-16, QR 1e-15). Where the roots of both crowd about one point the
Bézout matrix is nearly of lower rank and its cofactors cancel: quartics with roots within 0.05 of 1, such as P3P's in
x = b/a, are off by 1e-11 (worst 2e-8; QR 3e-16), while false hyper-edges of P3P show 1e-7 and true ones less. Taken
about that point (``about_one``) the loss becomes a gain: 1e-25, worst 1e-21. The resultant is the same in x and in
z = x − 1, and so is the Bézout identity; only the norms are taken in x.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import combinations
from typing import Any

from rootmatch.algebra.any_degree import NO_INFORMATION, coefficient_names, compile_text
from rootmatch.jit.decorators import scalar


@cache
def make_last_entry_kernel(degree: int, *, about_one: bool = False) -> Any:
    """Kernel ``(p_k, …, p_0, q_k, …, q_0) → |R_2k,2k|`` of both scaled to unit 2-norm; 0 for two common roots or more.

    ``about_one``: of polynomials in x whose coefficients are given in z = x − 1. `NO_INFORMATION` if one is zero.
    """
    names = {"NO_INFORMATION": NO_INFORMATION}
    return scalar(compile_text(_last_entry_text(degree, about_one), "last_entry", names))


@cache
def make_lesser_entry_kernel(degree: int, *, about_one: bool = False) -> Any:
    """Kernel ``(p_k, …, p_0, q_k, …, q_0) →`` the lesser |R_2k,2k| over the polynomials in x and in 1/x.

    |R_2k,2k| = σ_min ‖y‖ / |y_last| with y the null vector (x^{2k−1}, …, 1), so the one-sided value blows up when the
    common root has |x| > 1; the lesser of the two stays within a factor √(2k) of σ_min at a common root.
    """
    p, q = coefficient_names("p", degree), coefficient_names("q", degree)
    back = [*p[::-1], *q[::-1]]
    if about_one:  # by powers of w = 1/x − 1, where z = −w / (1 + w)
        back = [
            _weighted_sum(letter, [(-1) ** k * math.comb(degree - k, power - k) for k in range(power + 1)])
            for letter in ("p", "q")
            for power in range(degree, -1, -1)
        ]
    text = f"def lesser({', '.join(p + q)}):\n    return min(last({', '.join(p + q)}), last({', '.join(back)}))\n"
    return scalar(compile_text(text, "lesser", {"last": make_last_entry_kernel(degree, about_one=about_one)}))


def _weighted_sum(letter: str, weights: Sequence[int]) -> str:
    """Text of a sum of the first of some numbers ``letter0, …``, each with its weight; those of weight 0 left out."""
    return " + ".join(f"{float(weight)!r} * {letter}{k}" for k, weight in enumerate(weights) if weight)


def _squared_norm(letter: str, count: int, about_one: bool) -> str:
    """Text of the squared norm of ``letter0, …``, coefficients in x, or in x − 1 of what is a polynomial in x."""
    terms = [f"{letter}{k}" for k in range(count)]
    if about_one:
        rows = [[(-1) ** (k + i) * math.comb(k, i) for k in range(count)] for i in range(count)]
        terms = [f"({_weighted_sum(letter, row)})" for row in rows]
    return " + ".join(f"{term} * {term}" for term in terms)


def _last_entry_text(degree: int, about_one: bool) -> str:
    """|Res| / ‖(s, t)‖ by the Bézout matrix, its determinant and the first column of its adjugate."""
    names = coefficient_names("p", degree) + coefficient_names("q", degree)
    lines = [f"def last_entry({', '.join(names)}):"]
    for i in range(degree):
        for j in range(i, degree):
            terms = []
            for k in range(i + 1):
                high, low = i + j + 1 - k, k
                if high <= degree:
                    terms.append(f"(p{high} * q{low} - p{low} * q{high})")
            lines.append(f"    b{i}_{j} = {' + '.join(terms)}")

    def entry(i: int, j: int) -> str:
        return f"b{min(i, j)}_{max(i, j)}"

    def minor(columns: tuple[int, ...]) -> str:
        return "m" + "_".join(map(str, columns)) if len(columns) > 1 else entry(degree - 1, columns[0])

    for size in range(2, degree):
        row = degree - size
        for columns in combinations(range(degree), size):
            parts = []
            for place, column in enumerate(columns):
                rest = columns[:place] + columns[place + 1 :]
                parts.append(f"{'-' if place % 2 else '+'} {entry(row, column)} * {minor(rest)}")
            lines.append(f"    {minor(columns)} = {' '.join(parts)}")
    for j in range(degree):
        rest = tuple(column for column in range(degree) if column != j)
        value = minor(rest) if rest else "1.0"
        lines.append(f"    c{j} = {'-' if j % 2 else ''}{value}")
    lines.append(f"    det = {' + '.join(f'{entry(0, j)} * c{j}' for j in range(degree))}")
    for letter in ("p", "q"):
        lines.append(f"    norm_{letter} = {_squared_norm(letter, degree + 1, about_one)}")
        for m in range(degree):
            terms = [f"c{j} * {letter}{j + m + 1}" for j in range(degree) if j + m + 1 <= degree]
            lines.append(f"    {letter}t{m} = {' + '.join(terms)}")
        lines.append(f"    cofactor_{letter} = {_squared_norm(letter + 't', degree, about_one)}")
    lines += [
        "    square = norm_q * cofactor_p + norm_p * cofactor_q",
        "    value = abs(det) / math.sqrt(square if square > 0.0 else 1.0)",
        "    return value if norm_p * norm_q > 0.0 else NO_INFORMATION",
    ]
    return "\n".join(lines) + "\n"
