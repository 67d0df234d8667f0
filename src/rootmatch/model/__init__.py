"""Models of what is observed: absolute evidence of hypotheses, and the posterior that all that is told follows from."""
