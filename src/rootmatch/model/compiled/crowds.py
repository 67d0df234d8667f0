"""Clutter that crowds, its densities and shares, compiled: see `rootmatch.model.clutter`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def shares_of_crowds(densities, prior, steps, shares):  # type: ignore[no-untyped-def]
    """Most probable shares (S,) of components with densities (S, n'), by expectation and maximisation, in place.

    ``prior`` (S,): pseudo-counts; ``steps``: how many; ``shares``: those to start from.
    """
    densities, prior, shares = borrowed((densities, prior, shares))
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


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def densities_of_crowds(target, sigma, centres, label, widths, about, whole):  # type: ignore[no-untyped-def]
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
    """
    target, sigma, centres, label, widths, about, whole = borrowed(
        (target, sigma, centres, label, widths, about, whole)
    )
    every = centres.shape[0] == target.shape[0]
    others = centres.shape[0] - 1
    for k in range(about.shape[0]):
        for i in range(target.shape[0]):
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
