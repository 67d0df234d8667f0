"""What runs the kernels over many hyper-edges: processor cores or a GPU."""
