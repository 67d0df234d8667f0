"""Polynomials, resultants and vectors: scalar kernels that several problems share."""
