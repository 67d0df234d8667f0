"""All that depends on what Numba does not document, and how kernels are compiled."""
