"""The cost of single precision: which hyper-edges screening in float32 loses, and how many pass needlessly.

    python benchmarks/single_precision.py --seeds 20

Each scene has ten points and two detections of clutter (eleven and nine for 3P1); every hyper-edge is evaluated in
float64 and by the float32 twin of the same kernel, compiled for the processor. A hyper-edge counts as lost when its
residual in float64 is below the gate (3.5) and that in float32 above the widened gate. The scenes: as in the paper;
*distant*, ten times as far with ten times the focal length; *close*, from 4.8 units with a wide angle; *flat*, the
points within a hundredth of the cube; *both*, distant and flat. Seeds below 4000 are for tuning.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from shared import head, parser, row

from rootmatch.backends.strongest import Enumeration
from rootmatch.cameras.pinhole import Camera
from rootmatch.hypergraph.affinity import KINDS, affinity
from rootmatch.hypergraph.enumeration import farthest_point_order
from rootmatch.jit import float32
from rootmatch.problems.residual_dispatch import (
    PANEL_ROWS,
    SCRATCH_COLUMNS,
    SCRATCH_ROWS,
    fill_panel,
    gives_squares,
    slab_residual,
)
from rootmatch.simulation import FOCAL, HEIGHT, SCENES, WIDTH

VARIANTS: dict[str, tuple[float, float, float]] = {
    "paper": (1.0, 1.0, 1.0),
    "distant": (10.0, 10.0, 1.0),
    "close": (0.4, 0.4, 1.0),
    "flat": (1.0, 1.0, 0.01),
    "both": (10.0, 10.0, 0.01),
}
"""Factors of the camera's distance, of its focal length and of the points' extent along one horizontal axis."""
WIDEST = 2.0
"""Factor of the gate up to which float32 residuals are recorded."""


def made(problem: str, name: str, sigma: float, seed: int, n: int, clutter: int) -> tuple[Any, NDArray[np.int64], Any]:
    """Tables, true assignment and problem of a scene; points wide first."""
    if problem == "3p1":
        scene = SCENES[problem](n=n, outliers=clutter, noise=sigma, seed=seed, baseline=5.0)
        order = farthest_point_order(scene.source)
        return scene.problem.prepare(scene.source[order], scene.target, sigma), scene.truth[order], scene.problem
    scene = SCENES[problem](n=n, seed=seed)
    far, long, flat = VARIANTS[name]
    points = scene.source * (1.0, 1.0, flat)
    R, t = scene.poses[0]
    camera = Camera(long * FOCAL, long * FOCAL, WIDTH / 2.0, HEIGHT / 2.0)
    rng = np.random.default_rng(seed)
    seen = camera.project(points @ R.T + far * t) + sigma * rng.standard_normal((n, 2))
    target = np.concatenate([seen, rng.uniform((0.0, 0.0), (WIDTH, HEIGHT), (clutter, 2))])
    place = rng.permutation(n + clutter)
    order = farthest_point_order(points)
    set_up = replace(scene.problem, camera=camera)
    return set_up.prepare(points[order], target[place], sigma), np.argsort(place)[order], set_up


@njit(error_model="numpy")
def compared(  # type: ignore[no-untyped-def]
    tables, blurred, kind, bases, arrangements, gate, widest, points, panels, scratches, outs, codes, values
):  # fmt: skip
    """Record codes and residuals in both precisions of what either keeps; returns their number."""
    panel, panel_single = panels
    scratch, scratch_single = scratches
    out, out_single = outs
    d = bases.shape[1] + 1
    targets = out.shape[1]
    i, j = np.empty(d, np.int64), np.empty(d, np.int64)
    squares = gives_squares(tables, kind)
    count = 0
    for base in range(bases.shape[0]):
        for order in range(arrangements.shape[0]):
            for k in range(d - 1):
                i[k], j[k] = bases[base, k], arrangements[order, k]
            first = bases[base, d - 2] + 1
            rows = points - first
            i[d - 1], j[d - 1] = first, 0
            fill_panel(tables, kind, i, j, panel)
            slab_residual(tables, kind, i, j, first, panel, scratch, out[:rows])
            i[d - 1], j[d - 1] = first, 0
            fill_panel(blurred, kind, i, j, panel_single)
            slab_residual(blurred, kind, i, j, first, panel_single, scratch_single, out_single[:rows])
            for r in range(rows):
                for m in range(targets):
                    taken = False
                    for k in range(d - 1):
                        taken = taken or arrangements[order, k] == m
                    one, two = out[r, m], np.float64(out_single[r, m])
                    if squares:
                        one, two = np.sqrt(one), np.sqrt(two)
                    if not taken and (one <= gate or two <= widest) and count < codes.shape[0]:
                        codes[count] = ((base * arrangements.shape[0] + order) * points + first + r) * targets + m
                        values[count, 0], values[count, 1] = one, two
                        count += 1
    return count


def in_single(tables: Any) -> Any:
    """Tables as the screening sees them; likewise for 3P1, which has none."""
    if hasattr(tables, "variance"):
        return float32.round_tables(tables)
    blur = float32.ROUNDING * float32.EPSILON
    fields = {
        name: np.hypot(field, blur) if name.endswith("deviation") else field
        for name, field in zip(tables._fields, tables, strict=True)
    }
    return type(tables)(**{name: field.astype(np.float32) for name, field in fields.items()})


def residuals(problem: str, kind: str, name: str, sigma: float, seed: int, n: int, clutter: int) -> Any:
    """Residuals (E, 2) in float64 and float32 of what either keeps, and which of them are true."""
    tables, truth, set_up = made(problem, name, sigma, seed, n, clutter)
    weigh = affinity(kind)
    shape = n, n + clutter
    work = Enumeration.of(tables, KINDS[kind](), shape, set_up.order, None)
    kinds = np.float64, np.float32
    panels = tuple(np.zeros((PANEL_ROWS, shape[1]), dtype) for dtype in kinds)
    scratches = tuple(np.zeros((SCRATCH_ROWS, max(n, SCRATCH_COLUMNS)), dtype) for dtype in kinds)
    outs = tuple(np.zeros((n, shape[1]), dtype) for dtype in kinds)
    codes, values = np.empty(4_000_000, np.int64), np.empty((4_000_000, 2))
    count = compared(
        tables, in_single(tables), work.kind, work.bases, work.arrangements, weigh.gate, WIDEST * weigh.gate, n,
        panels, scratches, outs, codes, values,
    )  # fmt: skip
    rest, last_target = np.divmod(codes[:count], shape[1])
    rank, last = np.divmod(rest, n)
    base, order = np.divmod(rank, len(work.arrangements))
    true = (truth[work.bases[base]] == work.arrangements[order]).all(axis=1) & (truth[last] == last_target)
    return values[:count], true, weigh.gate


def print_row(problem: str, kind: str, name: str, sigma: float, seeds: range, widenings: list[float]) -> None:
    """Print one line of the table."""
    n, clutter = (11, 0) if problem == "3p1" else (10, 2)
    parts = [residuals(problem, kind, name, sigma, seed, n, clutter) for seed in seeds]
    values, true, gate = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]), parts[0][2]
    inside = values[:, 0] <= gate
    lost, lost_true, extra = [], [], []
    for widening in widenings:
        kept = values[:, 1] <= gate * widening
        lost.append(np.sum(inside & ~kept))
        lost_true.append(np.sum(inside & true & ~kept))
        extra.append(np.sum(kept & ~inside) / max(inside.sum(), 1))
    apart = np.abs(values[inside, 1] - values[inside, 0])
    quantiles = np.quantile(apart, (0.5, 0.99)) if apart.size else (0.0, 0.0)
    row(
        f"{problem} `{kind}`", name, f"{sigma:g}", f"{inside.sum():,}", f"{np.sum(inside & true):,}",
        *(f"{a:,} ({b:,})" for a, b in zip(lost, lost_true, strict=True)),
        " / ".join(f"{100 * share:.1f} %" for share in extra), f"{quantiles[0]:.0e}, {quantiles[1]:.0e}",
    )  # fmt: skip


def main() -> None:
    ask = parser(__doc__, seeds=20, first=1000)
    ask.add_argument("--sigmas", type=float, nargs="+", default=[0.0, 0.5, 1.0, 2.0])
    ask.add_argument("--scenes", nargs="+", default=list(VARIANTS))
    ask.add_argument("--problems", nargs="+", default=["p3p", "up2p", "3p1"])
    ask.add_argument("--kinds", nargs="+", default=["joint", "normalised"])
    ask.add_argument("--widenings", type=float, nargs="+", default=[1.0, 1.02, 1.05])
    ask.add_argument("--rounding", type=float, default=float32.ROUNDING, help="see rootmatch.jit.float32")
    options = ask.parse_args()
    float32.ROUNDING = options.rounding
    heads = [f"lost at {widening:g} (true)" for widening in options.widenings]
    head("residual", "scene", "σ", "below the gate", "true", *heads, "needless", "off by")
    seeds = range(options.first, options.first + options.seeds)
    for problem in options.problems:
        for kind in options.kinds:
            for name in options.scenes if problem != "3p1" else ["paper"]:
                for sigma in options.sigmas:
                    print_row(problem, kind, name, sigma, seeds, options.widenings)


if __name__ == "__main__":
    main()
