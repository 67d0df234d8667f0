"""A tensor whose hyper-edges are evaluated when they are first asked for."""

from __future__ import annotations

from collections.abc import Callable
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
