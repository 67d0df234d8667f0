"""Kernels of derived problems: their tables, and the loops composed around generated formulas."""
