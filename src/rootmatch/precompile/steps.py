"""Steps that compile kernels: calls of the public functions, as a user makes them.

Kernels are not listed. What a call needs is compiled by it, so a new kernel, problem, residual or solver is covered as
soon as a call here reaches it; `tests/test_prebuilt.py` finds what none reaches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from rootmatch.api import match, residuals
from rootmatch.hypergraph.affinity import KINDS
from rootmatch.hypergraph.random_tuples import permuted_tuples
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.matcher import Matcher
from rootmatch.precompile.scenes import Sample, sample, simulate_sample
from rootmatch.problems import PROBLEMS
from rootmatch.problems.pose_fit.pose_prior import PosePrior
from rootmatch.problems.residual_dispatch import residual_kinds_of_tables
from rootmatch.solvers import SOLVERS
from rootmatch.tracking.tracker import Tracker

Step = Callable[[], object]
PAPER = ("p3p", "up2p", "3p1")
SEARCHED = ("p3p", "up2p")
"""Problems of the paper, and those with a guided search and several motions."""


def match_scene(scene: Sample, **options: Any) -> None:
    """A match whose score is read, as by a user."""
    _ = match(scene.source, scene.target, scene.problem, **{"noise": scene.noise, **options}).score


def list_residuals(scene: Sample, kind: str) -> None:
    """Residuals of one hyper-edge."""
    index = np.arange(scene.problem.order)[None]
    residuals(
        scene.source, scene.target, scene.problem, source_index=index, target_index=index, kind=kind, noise=scene.noise
    )


def match_frames_twice(scene: Sample) -> None:
    """Two frames, each by itself."""
    matcher = Matcher(scene.source, scene.problem, noise=scene.noise)
    for _ in range(2):
        matcher.match(scene.target)


def match_alike_bodies(scene: Sample) -> None:
    """Matches of another body, which is alike: more and more of its points are elsewhere."""
    rng = np.random.default_rng(0)
    for first in (8, 6, 4):
        source = scene.source.copy()
        source[first:] += 0.01 * np.ptp(source) * rng.normal(size=source[first:].shape)
        match_scene(replace(scene, source=source))


def track_frames(scene: Sample) -> None:
    """Three frames, each predicted by those before; the last shows too little to be sure at once."""
    tracker = Tracker(scene.source, scene.problem, noise=scene.noise)
    for target in (scene.target, scene.target, scene.target[::2]):
        tracker.update(target)


@cache
def tensor(order: int) -> AffinityTensor:
    """Random hyper-edges, a few of which agree."""
    rng = np.random.default_rng(0)
    shape, count = (6, 7), 2000
    sources = permuted_tuples(rng, count, shape[0], order)
    targets = permuted_tuples(rng, count, shape[1], order)
    return AffinityTensor.unchecked((sources * shape[1] + targets).astype(np.int32), rng.random(count), shape)


def solve_random_tensor(solver: str, order: int) -> None:
    """A tensor solved."""
    SOLVERS[solver](tensor(order))


def _has_residual(name: str, kind: str) -> bool:
    scene = sample(name)
    tables = scene.problem.prepare(scene.source, scene.target, scene.noise)
    return KINDS[kind] in residual_kinds_of_tables(tables)


def first_steps() -> dict[str, Step]:
    """Steps for the first match of most users: the problems of the paper, guided, and with several motions.

    What takes long and shares little comes first, so that workers do not wait for one another.
    """
    steps: dict[str, Step] = {"solver ascent, order 4": partial(solve_random_tensor, "ascent", 4)}
    steps |= {f"match {name}": partial(match_scene, sample(name)) for name in PAPER}
    steps["p3p of few points"] = partial(match_scene, simulate_sample("p3p", 5, 3))  # which have several poses
    for name in SEARCHED:
        scene = simulate_sample(name, 12, 8)
        steps[f"guided {name}"] = partial(match_scene, scene, sampler="guided")
        steps[f"motions {name}"] = partial(match_scene, simulate_sample(name, 10, 2, motions=2), motions=2)
    steps["guided p3p of many points"] = partial(match_scene, simulate_sample("p3p", 30, 5), sampler="guided")
    return steps


def prebuilt_steps() -> dict[str, Step]:
    """Steps for the kernels of a wheel: all of `first_steps`, every problem and solver, and the paper's preset."""
    steps = first_steps()
    steps |= {f"match {name}": partial(match_scene, sample(name)) for name in PROBLEMS if name not in PAPER}
    for name in ("up2pf", "3p1", "planar"):  # which are searched otherwise
        steps[f"sweep of {name}"] = partial(match_scene, sample(name), sampler="exhaustive")
    steps |= {
        f"solver {name}, order {order}": partial(solve_random_tensor, name, order)
        for name in SOLVERS
        for order in (4, 3)
    }
    for name in PAPER:
        steps[f"paper {name}"] = partial(match_scene, simulate_sample(name, 8, 0), preset="paper", samples=2000)
    for name in PROBLEMS:
        steps[f"residuals {name}"] = partial(list_residuals, sample(name), "joint")
    for name in SEARCHED:
        scene = simulate_sample(name, 12, 8)
        facing = scene.source - scene.source.mean(axis=0)
        steps[f"guided {name} with normals"] = partial(match_scene, scene, sampler="guided", normals=facing)
        steps[f"{name} of another body"] = partial(match_alike_bodies, scene)
        steps[f"frames {name}"] = partial(match_frames_twice, sample(name))
        steps[f"tracked {name}"] = partial(track_frames, simulate_sample(name, 12, 3))
    everything = np.ones((8, 10), dtype=bool)
    steps["p3p of a dense image"] = partial(match_scene, simulate_sample("p3p", 120, 5), noise=10.0)
    steps["noise of p3p"] = partial(match_scene, sample("p3p"), noise="auto")
    steps["candidates of p3p"] = partial(match_scene, sample("p3p"), candidates=everything)
    steps["p3p of a known rotation"] = partial(
        match_scene, sample("p3p"), prior=PosePrior.unchecked(rotation=(np.eye(3), np.eye(3)))
    )
    steps["motions of up2p counted"] = partial(match_scene, simulate_sample("up2p", 10, 2, motions=2), motions="auto")
    return steps


def all_steps() -> dict[str, Step]:
    """Steps for everything: all of `prebuilt_steps`, and every residual of every problem, exhaustive and of a list."""
    steps = prebuilt_steps()
    for name in PROBLEMS:
        for kind in KINDS:
            if kind != "joint" and _has_residual(name, kind):
                steps[f"match {name} by {kind}"] = partial(match_scene, sample(name), residual=kind)
                steps[f"residuals {name}, {kind}"] = partial(list_residuals, sample(name), kind)
    return steps


STEPS: dict[str, Callable[[], dict[str, Step]]] = {"first": first_steps, "prebuilt": prebuilt_steps, "all": all_steps}
"""Sets of steps by name."""
