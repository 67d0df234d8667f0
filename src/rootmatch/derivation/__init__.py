"""Derivation of problems from SymPy equations (the extra ``symbolic``).

A statement that cannot be used raises `InputError`; a result that fails a check, `RootmatchError`.
"""
