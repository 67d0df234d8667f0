"""Selection of the backend: the CPU or an NVIDIA GPU."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any, Literal

from rootmatch.backends import cpu
from rootmatch.backends.strongest import Backend
from rootmatch.errors import InputError
from rootmatch.hypergraph.tensor import AffinityTensor

Name = Literal["auto", "cpu", "cuda", "cuda-float32"]
NAMES: tuple[Name, ...] = ("auto", "cpu", "cuda", "cuda-float32")
ON_CARD: tuple[Name, ...] = ("cuda", "cuda-float32")
PAYS = 200_000_000
"""Hyper-edges from which ``"auto"`` prefers a card: below, starting it takes longer than the processor's whole work."""


def device_backend() -> Backend:
    """The CUDA backend."""
    if find_spec("numba_cuda") is None:
        raise InputError(
            'backend: "cuda" needs numba-cuda, which is not installed; pip install "rootmatch[gpu]", or use "cpu"'
        )
    from numba import cuda

    if not cuda.is_available():
        reason = cuda.cuda_error()
        found = "no NVIDIA card or driver" if reason is None else str(reason).strip().partition("\n")[0]
        raise InputError(f'backend: "cuda" given, but numba-cuda finds no GPU it can use ({found}); use "cpu"')
    from rootmatch.backends import cuda as backend
    from rootmatch.jit.cuda import register_kernels

    register_kernels()
    return backend


def is_device(backend: Any) -> bool:
    """Whether a backend is the card."""
    return getattr(backend, "__name__", "") in ("rootmatch.backends.cuda", "rootmatch.backends.cuda_float32")


def choose_backend(name: Name, count: float, single: bool = False) -> Backend:
    """The backend of that name; ``"auto"`` is the card where there is one and ``count`` hyper-edges make it pay.

    ``single`` says that there are kernels of single precision: then ``"auto"`` screens by them on cards that are slow
    in double.
    """
    if name == "cpu" or (name == "auto" and count < PAYS):
        return cpu
    try:
        backend = device_backend()
    except (InputError, ImportError):
        if name == "auto":
            return cpu
        raise
    if name == "auto" and getattr(backend, "SIMULATED", False):  # slower than anything
        return cpu
    if name == "cuda" or (name == "auto" and not single):
        return backend
    from rootmatch.backends import cuda_float32

    return cuda_float32 if name == "cuda-float32" or cuda_float32.pays() else backend


def place_tensor(tensor: AffinityTensor, backend: Any) -> AffinityTensor:
    """The tensor where the backend can contract it."""
    if not is_device(backend):
        return tensor
    from rootmatch.backends.cuda_contraction import DeviceTensor

    return DeviceTensor.of(tensor)
