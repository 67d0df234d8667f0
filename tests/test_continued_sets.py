"""Point sets that repeat themselves: another lattice with the same spacing is not trusted, a part of more is."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.algebra.rotation import one_rotation_matrix
from rootmatch.arrays import Floats, Integers

SPACING, NOISE = 30.0, 0.2


def lattice(rng: np.random.Generator, *count: int, holes: int) -> Floats:
    """Points of a lattice (n, 3), some of them missing."""
    every = SPACING * np.stack(np.meshgrid(*(np.arange(k) for k in count), indexing="ij"), axis=-1).reshape(-1, 3)
    return every[np.sort(rng.permutation(len(every))[holes:])]


def measured(rng: np.random.Generator, points: Floats) -> tuple[Floats, Integers]:
    """Points that are moved, shuffled among three others, and the target of each point, −1 for none."""
    seen = rng.random(len(points)) < 0.95
    strays = rng.uniform(points.min(axis=0) - 10.0, points.max(axis=0) + 10.0, (3, 3))
    every = np.concatenate([points[seen], strays]) @ one_rotation_matrix(rng.normal(0.0, 1.0, 3)).T
    order = rng.permutation(len(every))
    truth = np.full(len(points), -1)
    truth[seen] = np.argsort(order)[: seen.sum()]
    return every[order] + rng.normal(0.0, NOISE, every.shape) + 100.0, truth


@pytest.mark.parametrize("seed", range(3))
def test_another_lattice_is_not_trusted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source, other = lattice(rng, 6, 5, 1, holes=4), lattice(rng, *((7, 6), (5, 5), (6, 5))[seed], 1, holes=4)
    match = rm.match(source, measured(rng, other)[0], rm.Rigid(), noise=(0.0, NOISE))
    assert not match
    assert "same repeating pattern" in match.advice


def test_the_lattice_is_trusted_and_so_is_a_part_of_a_larger_one() -> None:
    """Of the parts none was: what continues them matches as well a period away."""
    rng = np.random.default_rng(1)
    whole = lattice(rng, 11, 9, 1, holes=10)
    own = (whole[:, 0] < 7.5 * SPACING) & (whole[:, 1] < 5.5 * SPACING)
    for points in (np.concatenate([whole[own], whole[~own]]), whole[own]):
        target, truth = measured(rng, points)
        match = rm.match(whole[own], target, rm.Rigid(), noise=(0.0, NOISE))
        assert match
        assert (match.assignment == truth[: own.sum()]).all()


def test_another_lattice_is_not_trusted_beside_another_body() -> None:
    rng = np.random.default_rng(0)
    source, other, tool = lattice(rng, 6, 5, 1, holes=4), lattice(rng, 9, 8, 1, holes=4), rng.uniform(-50, 50, (6, 3))
    target = np.concatenate([measured(rng, other)[0], tool + 400.0])
    bodies = ["lattice"] * len(source) + ["tool"] * len(tool)
    match = rm.match(np.concatenate([source, tool]), target, rm.Rigid(), noise=(0.0, NOISE), bodies=bodies)
    assert match.bodies is not None
    assert not match.bodies["lattice"]
    assert "same repeating pattern" in match.bodies["lattice"].advice
    assert match.bodies["tool"]
