"""Tensors made of others: of some points as of all, of several, and when their hyper-edges are first asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.tensor import AffinityTensor


class DeferredTensor(AffinityTensor):
    """An `AffinityTensor` made by a function on first access to its hyper-edges; its shape and prior are known."""

    @classmethod
    def of(
        cls, make: Callable[[], AffinityTensor], shape: tuple[int, int], unary: NDArray[np.float64] | None = None
    ) -> DeferredTensor:
        """The tensor that ``make`` makes, with other unary weights."""
        tensor = object.__new__(cls)
        vars(tensor).update(shape=shape, unary=unary, make=make)
        return tensor

    def __getattr__(self, name: str) -> Any:
        """The hyper-edges or their weights, which are not there yet."""
        make = vars(self).get("make")
        if make is None or name not in ("indices", "weights"):
            raise AttributeError(name)
        made = make()
        vars(self).update(indices=made.indices, weights=made.weights, make=None)
        return vars(self)[name]

    def __getstate__(self) -> dict[str, Any]:
        """State for pickling: the hyper-edges instead of the function."""
        return {"indices": self.indices, "weights": self.weights, "shape": self.shape, "unary": self.unary}


def renumber_tensor(
    tensor: AffinityTensor,
    places: tuple[NDArray[np.integer], NDArray[np.integer]],
    shape: tuple[int, int],
    unary: NDArray[np.float64] | None = None,
) -> AffinityTensor:
    """The hyper-edges of a tensor among other points; ``places``: which of those its points are, and its targets."""
    source, target = places
    i, j = np.divmod(tensor.indices, np.int32(tensor.shape[1]))
    indices = source.astype(np.int32)[i] * np.int32(shape[1]) + target.astype(np.int32)[j]
    return AffinityTensor.unchecked(indices, np.asarray(tensor.weights), shape, unary)


def concatenate_tensors(
    parts: Sequence[AffinityTensor], shape: tuple[int, int], unary: NDArray[np.float64] | None, maximum: int
) -> AffinityTensor:
    """The hyper-edges of several tensors of the same points, one tensor after the other, the strongest ones at most."""
    indices, weights = zip(*((part.indices, part.weights) for part in parts), strict=True)
    return keep_strongest(
        AffinityTensor.unchecked(np.concatenate(indices), np.concatenate(weights), shape, unary), maximum
    )


def keep_strongest(tensor: AffinityTensor, maximum: int) -> AffinityTensor:
    """The strongest hyper-edges of a tensor, at most so many, in their order."""
    if tensor.size <= maximum:
        return tensor
    kept = np.sort(np.argpartition(-tensor.weights, maximum)[:maximum])
    return AffinityTensor.unchecked(tensor.indices[kept], tensor.weights[kept], tensor.shape, tensor.unary)
