"""Research on the method, which no match needs: the paper's experiments, public protocols and benchmarks."""
