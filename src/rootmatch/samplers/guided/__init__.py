"""Guided choice of hyper-edges: minimal sets propose where every point is seen, and what they propose is weighed.

Exhaustion looks at C(n, d) · n'!/(n' − d)! hyper-edges, of which all but C(n, d) are false. Here a few wide minimal
sets of source points are tried with every image they may have; each solution predicts where the other points are seen,
and a sequential test ends the false ones after a look or two (`rootmatch.samplers.guided.hypothesis_test`). The
proposals that survive name candidate correspondences, and the hyper-edges among those, no others, go through the
ordinary residual into the tensor. No pose is handed on: the minimal problem proposes, the residual weighs,
the solver decides.
"""
