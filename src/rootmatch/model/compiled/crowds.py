"""Clutter that crowds, its densities and shares, compiled: see `rootmatch.model.clutter`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.elimination import factorise, solve_lower
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part

TINY = 1e-12
"""Below which a number is zero but for rounding."""
NEGLIGIBLE = 30.0
"""Squared deviation beyond which nothing crowds about a place. A round value."""


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fit_crowd_shares(densities, prior, steps, shares):  # type: ignore[no-untyped-def]
    """As `maximise_shares`."""
    densities, prior, shares = borrow((densities, prior, shares))
    maximise_shares(densities, prior, steps, shares)


@part
def maximise_shares(densities, prior, steps, shares):  # type: ignore[no-untyped-def]
    """Most probable shares (S,) of components with densities (S, n'), by expectation and maximisation, in place.

    ``prior`` (S,): pseudo-counts; ``steps``: how many; ``shares``: those to start from.
    """
    count = shares.shape[0]
    total = np.empty(count)
    for _ in range(steps):
        for s in range(count):
            total[s] = prior[s]
        for j in range(densities.shape[1]):
            whole = 0.0
            for s in range(count):
                whole += shares[s] * densities[s, j]
            for s in range(count):
                total[s] += shares[s] * densities[s, j] / whole
        every = 0.0
        for s in range(count):
            every += total[s]
        for s in range(count):
            shares[s] = total[s] / every


@part
def fill_crowd_densities(target, sigma, centres, label, widths, about, whole, first, last):  # type: ignore[no-untyped-def]
    """Densities of members of crowds of several widths.

    Parameters
    ----------
    target, sigma : (n', k) and (n',) arrays
        Detections.
    centres : (c,) int64 array
        Detections about which others crowd.
    label : (n',) int64 array
        Image of each detection; no crowd reaches into another one.
    widths : (S, k) array
        Standard deviations of crowds along each axis.
    about : (S, n', c) array
        Density at each detection about each centre; zero about itself. Filled.
    whole : (S, n') array
        Mean of those about the others, filled.
    first, last : int
        Of which detections; those before are filled.
    """
    every = centres.shape[0] == target.shape[0]
    others = centres.shape[0] - 1
    for k in range(about.shape[0]):
        for i in range(first, last):
            total = 0.0
            for c in range(centres.shape[0]):
                j, density = centres[c], 0.0
                if every and c < i:
                    density = about[k, c, i]
                elif i != j and label[i] == label[j]:
                    squared, volume = 0.0, 1.0
                    for axis in range(target.shape[1]):
                        off, width = target[i, axis] - target[j, axis], widths[k, axis]
                        variance = width * width + sigma[i] * sigma[i] + sigma[j] * sigma[j]
                        squared += off * off / variance
                        volume *= 2.0 * math.pi * variance
                    density = math.exp(-0.5 * squared) / math.sqrt(volume)
                about[k, i, c] = density
                total += density
            whole[k, i] = total / others


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fit_crowds(detections, centres, extents, limits, rows, out):  # type: ignore[no-untyped-def]
    """The crowds of an image.

    Parameters
    ----------
    detections : tuple
        Detections (n', k), their σ (n',), the densities (n',) of what lies anywhere, and the image (n',) of each.
    centres : (c,) int64 array
        Detections about which others may crowd.
    extents : (k,) array
        What clutter fills.
    limits : tuple
        Pseudo-counts of what lies anywhere and of each width, and steps of `maximise_shares`.
    rows : tuple
        Detections of this call, from and to: it takes several calls in order, the last of which ends it.
    out : tuple
        Density (n', c) of a member of a crowd about each centre at each detection, widths (S, k), shares (1 + S,)
        of what lies anywhere and of crowds by width, densities (S, n', c) of each width about each centre, and those
        (1 + S, n') of what lies anywhere and of the mean crowd; filled.
    """
    detections, centres, extents, out = borrow((detections, centres, extents, out))
    target, sigma, uniform, label = detections
    about, widths, shares, kernels, densities = out
    first, last = rows
    anywhere, crowd, steps = limits
    scales, size, count = widths.shape[0], extents.shape[0], target.shape[0]
    # crowds are round, but no wider than what clutter fills
    log_mean = 0.0
    for axis in range(size):
        log_mean += math.log(extents[axis]) / size
    for k in range(scales):
        for axis in range(size):
            widths[k, axis] = min(0.25 * math.exp(log_mean) * 0.5**k, 0.25 * extents[axis])
    for j in range(first, last):
        densities[0, j] = uniform[j]
    fill_crowd_densities(target, sigma, centres, label, widths, kernels, densities[1:], first, last)
    if last < count:
        return
    prior = np.empty(scales + 1)
    for k in range(scales + 1):
        prior[k] = crowd if k > 0 else anywhere
    for k in range(scales + 1):
        shares[k] = prior[k] / (anywhere + scales * crowd)
    maximise_shares(densities, prior, steps, shares)
    for j in range(count):
        for c in range(centres.shape[0]):
            about[j, c] = 0.0
            for k in range(scales):
                about[j, c] += shares[1 + k] * kernels[k, j, c]


@part
def factor_bordered(taken, more, descents, own, root, factor):  # type: ignore[no-untyped-def]
    """See `fill_log_of_taken`: the Cholesky factor of the matrix of what is taken or near a place, and how large it is.

    ``own``, ``root`` (c,): which centres these are, and the roots of what they have; filled.
    """
    size = 0
    for c in range(taken.shape[0]):
        if taken[c] or more[c] > 0.0:
            own[size], root[size] = c, 1.0 if taken[c] else math.sqrt(more[c])
            size += 1
    for a in range(size):
        for b in range(a + 1):
            factor[a, b] = root[a] * root[b] * descents[own[a], own[b]]
        factor[a, a] += 0.0 if taken[own[a]] else 1.0
    factorise(factor, size, TINY)
    return size


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_log_of_taken(taken, more, descents, log_density, out):  # type: ignore[no-untyped-def]
    """Logarithm of the density of centres that are taken, see `rootmatch.model.clutter.Clutter.log_density_of_taken`.

    Parameters
    ----------
    taken, more : (K, c) arrays
    descents : (c, c) array
    log_density : (c,) array
    out : (K,) array
        Filled.
    """
    taken, more, descents, log_density, out = borrow((taken, more, descents, log_density, out))
    count = descents.shape[0]
    own, root, factor = np.empty(count, np.int64), np.empty(count), np.empty((count, count))
    for k in range(taken.shape[0]):
        size = factor_bordered(taken[k], more[k], descents, own, root, factor)
        total = 0.0
        for a in range(size):
            total -= 2.0 * math.log(factor[a, a])
            if taken[k, own[a]]:
                total += log_density[own[a]]
        out[k] = total


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_given_densities(taken, more, descents, out):  # type: ignore[no-untyped-def]
    """Density (c,) of each centre in parts of its own, see `rootmatch.model.clutter.Clutter.log_density_of_each`.

    ``taken``, ``more`` (c,) and ``descents`` (c, c): as there; ``out`` (c,): filled.
    """
    taken, more, descents, out = borrow((taken, more, descents, out))
    count = descents.shape[0]
    own, root, factor = np.empty(count, np.int64), np.empty(count), np.empty((count, count))
    size = factor_bordered(taken, more, descents, own, root, factor)
    solved = np.empty(size)
    for j in range(count):
        for a in range(size):
            solved[a] = (1.0 if own[a] == j else 0.0) if taken[j] else root[a] * descents[own[a], j]
        squared = solve_lower(factor, size, solved)
        out[j] = squared + more[j] if taken[j] else 1.0 / max(descents[j, j] - squared, TINY)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_place_densities(target, sigma, places, variance, chance, widths, shares, density):  # type: ignore[no-untyped-def]
    """Densities of crowds about places, added to those given.

    Parameters
    ----------
    target, sigma : (n', k) and (n',) arrays
        Detections.
    places : (K, n, k) array
        About which they crowd.
    variance : (K, n) array
        Of the places, on each axis.
    chance : (K, n) array
        Weight of each place.
    widths, shares : (S, k) and (S,) arrays
        Of crowds, the widest first.
    density : (K, n') array
        Filled.
    """
    target, sigma, places, variance, chance, widths, shares, density = borrow(
        (target, sigma, places, variance, chance, widths, shares, density)
    )
    for k in range(places.shape[0]):
        for j in range(target.shape[0]):
            total = 0.0
            for i in range(places.shape[1]):
                if chance[k, i] > 0.0:
                    own = sigma[j] * sigma[j] + variance[k, i]
                    for s in range(widths.shape[0]):
                        squared, volume = 0.0, 1.0
                        for axis in range(target.shape[1]):
                            off = target[j, axis] - places[k, i, axis]
                            spread = widths[s, axis] * widths[s, axis] + own
                            squared += off * off / spread
                            volume *= 2.0 * math.pi * spread
                        if squared >= NEGLIGIBLE:  # and farther beyond the others, which are narrower
                            break
                        total += chance[k, i] * shares[s] * math.exp(-0.5 * squared) / math.sqrt(volume)
            density[k, j] = total
