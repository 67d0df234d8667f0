"""Derivation of problems from SymPy equations (the extra ``symbolic``)."""
