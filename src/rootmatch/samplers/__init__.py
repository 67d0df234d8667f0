"""Samplers: which hyper-edges are evaluated. All, random ones, or those that a guided search proposes."""
