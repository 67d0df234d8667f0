"""Samplers: they select the hyper-edges that are evaluated. All, random ones, completions, or a guided search."""
