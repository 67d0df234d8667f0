"""Contraction of an affinity tensor on an NVIDIA card, the same to the last bit in every run."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import ArrayLike, NDArray

from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.cuda import SIMULATED

THREADS = 2 if SIMULATED else 128
"""Threads per block, a power of two."""


def contract_kernel(indices, weights, x, starts, members, v):  # type: ignore[no-untyped-def]
    """v_a = Σ_{e∋a} h_e Π_{b∈e, b≠a} x_b: one block a correspondence, its hyper-edges shared among the threads.

    Each thread adds its own in order and the threads' sums are added in pairs, so no atomic addition, whose order
    chance decides, is needed. The product over the others is taken anew for each of the d correspondences: arithmetic
    is free where reading the indices takes the time.

    Parameters
    ----------
    indices : (E, d) int32 array
    weights : (E,) array
    x, v : (n n',) arrays
    starts : (n n' + 1,) int64 array
        Where the hyper-edges of each correspondence begin in ``members``.
    members : (d E,) int32 array
    """
    sums = cuda.shared.array(THREADS, np.float64)
    a = cuda.blockIdx.x
    thread = cuda.threadIdx.x
    total = 0.0
    for place in range(starts[a] + thread, starts[a + 1], THREADS):
        e = members[place]
        product = weights[e]
        for p in range(indices.shape[1]):
            b = indices[e, p]
            if b != a:
                product *= x[b]
        total += product
    sums[thread] = total
    cuda.syncthreads()
    half = THREADS // 2
    while half > 0:
        if thread < half:
            sums[thread] += sums[thread + half]
        cuda.syncthreads()
        half //= 2
    if thread == 0:
        v[a] = sums[0]


_contract = cuda.jit(contract_kernel, cache=not SIMULATED)


class DeviceTensor(AffinityTensor):
    """An affinity tensor that is contracted on the card; all else happens on the processor.

    The hyper-edges are copied there at the first contraction: 8 d + 8 bytes each.
    """

    @classmethod
    def of(cls, tensor: AffinityTensor) -> DeviceTensor:
        """A tensor, copied to the card."""
        made = cls.unchecked(tensor.indices, tensor.weights, tensor.shape, tensor.unary)
        assert isinstance(made, DeviceTensor)
        return made

    def _upload(self) -> Any:
        there = self.__dict__.get("_there")
        if there is None:
            flat = self.indices.ravel()
            members = (np.argsort(flat, kind="stable") // self.order).astype(np.int32)
            starts = np.zeros(self.shape[0] * self.shape[1] + 1, np.int64)
            np.cumsum(np.bincount(flat, minlength=starts.size - 1), out=starts[1:])
            there = tuple(cuda.to_device(array) for array in (self.indices, self.weights, starts, members))
            self.__dict__["_there"] = there
        return there

    def contract(self, x: ArrayLike) -> NDArray[np.float64]:
        """See `AffinityTensor.contract`."""
        if self.size == 0:
            return super().contract(x)
        soft = self._check_soft(x)
        indices, weights, starts, members = self._upload()
        v = cuda.device_array(soft.size, np.float64)
        with warnings.catch_warnings():
            # one block a correspondence, however few they are
            warnings.filterwarnings("ignore", message="Grid size")
            _contract[soft.size, THREADS](indices, weights, cuda.to_device(soft.ravel()), starts, members, v)
        result: NDArray[np.float64] = v.copy_to_host().reshape(self.shape)
        return result if self.unary is None else result + self.unary
