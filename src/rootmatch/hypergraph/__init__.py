"""The hypergraph: its hyper-edges, their affinities, the sparse tensor of them, and assignments."""
