"""Drivers that run the kernels over many hyper-edges: on the CPU, a GPU or several machines."""
