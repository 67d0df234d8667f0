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
    """The CUDA backend.

    Raises
    ------
    InputError
        If numba-cuda is not installed or finds no card; it says which.
    """
    if find_spec("numba_cuda") is None:
        raise InputError(
            'backend: "cuda" needs numba-cuda, which is not installed; pip install "rootmatch[gpu]", or use "cpu"'
        )
    from numba import cuda

    if not cuda.is_available():
        reason = cuda.cuda_error()
        found = "no NVIDIA card or driver" if reason is None else str(reason).splitlines()[0]
        raise InputError(f'backend: "cuda" given, but numba-cuda finds no GPU it can use ({found}); use "cpu"')
    from rootmatch.backends import cuda as backend

    return backend


def is_device(backend: Any) -> bool:
    """Whether a backend is the card."""
    return getattr(backend, "__name__", "") in ("rootmatch.backends.cuda", "rootmatch.backends.cuda_float32")


def chosen(name: Name, count: float, single: bool = False) -> Backend:
    """The backend of that name; ``"auto"`` is the card where there is one and ``count`` hyper-edges make it pay.

    ``single`` says that there are kernels of single precision: then ``"auto"`` screens by them on cards that are slow
    in double.

    Raises
    ------
    InputError
        If there is no GPU.
    """
    if name == "cuda-float32":
        device_backend()
        return _screening()
    if name == "cuda":
        return device_backend()
    if name == "auto" and count >= PAYS:
        try:
            backend: Any = device_backend()
        except (InputError, ImportError):
            return cpu
        # a simulated card is slower than anything
        if backend.SIMULATED:
            return cpu
        if single and _slow_in_double():
            return _screening()
        return device_backend()
    return cpu


def _screening() -> Backend:
    """The backend that screens in single precision, where there is a card."""
    from rootmatch.backends import cuda_float32

    return cuda_float32


def _slow_in_double() -> bool:
    """Whether the card is one on which that pays."""
    from rootmatch.backends import cuda_float32

    return cuda_float32.pays()


def placed(tensor: AffinityTensor, backend: Any) -> AffinityTensor:
    """The tensor where the backend can contract it."""
    if not is_device(backend):
        return tensor
    from rootmatch.backends.cuda_contraction import DeviceTensor

    return DeviceTensor.of(tensor)
