"""Guided sampling: minimal sets predict where the other points are, and only what they predict is evaluated.

There are C(n, d) · n'!/(n' − d)! hyper-edges, of which at most C(n, d) are correct. Here a few wide minimal sets of
source points are tried with all their possible images. Each solution is a hypothesis of the pose: it predicts where the
other points appear, and a sequential test drops the false ones after one or two points
(`rootmatch.samplers.guided.sequential_test`). The surviving hypotheses name candidate correspondences, and the
hyper-edges among those, no others, are evaluated with the ordinary residual. No pose is handed on: the minimal problem
predicts, the residual weighs, the solver decides.
"""
