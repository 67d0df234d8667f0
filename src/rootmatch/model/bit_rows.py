"""Rows of truth values packed into words, of which some true ones are chosen without a list of all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Integers

WORD = 64
"""Bits of a word."""


def pack_words(mask: Bools) -> NDArray[np.uint64]:
    """Rows (..., n) of truth values as words (..., W)."""
    packed = np.packbits(mask, axis=-1, bitorder="little")
    out = np.zeros((*mask.shape[:-1], -(-mask.shape[-1] // WORD) * WORD // 8), np.uint8)
    out[..., : packed.shape[-1]] = packed
    return out.view(np.uint64)


def clear_bits(words: NDArray[np.uint64], row: Integers, column: Integers) -> None:
    """Make values of words (R, W) false, one in each of some rows (K,), each of which is given once."""
    words.view(np.uint8)[row, column // 8] &= ~(1 << column % 8).astype(np.uint8)


def choose_bits(words: NDArray[np.uint64], maximum: int) -> tuple[Integers, Integers]:
    """Rows and columns (K,) of the true values of words (R, W), in order; of more than ``maximum`` a seeded draw."""
    packed = words.view(np.uint8)
    last = np.cumsum(np.bitwise_count(words).sum(axis=1, dtype=np.int64))
    chosen = np.arange(total := int(last[-1]) if len(last) else 0)
    if total > maximum:
        chosen = np.sort(np.random.default_rng(1).choice(total, maximum, replace=False))
    row = np.searchsorted(last, chosen, "right")
    # how many of its row are true from a chosen one on: from the end of the row it is the first with as many
    rest = np.unpackbits(packed[row], axis=1, bitorder="little")[:, ::-1].cumsum(axis=1, dtype=np.int32)
    first = (rest == (last[row] - chosen)[:, None]).argmax(axis=1)
    return row, rest.shape[1] - 1 - first
