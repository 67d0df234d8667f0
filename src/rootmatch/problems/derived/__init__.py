"""Problems made of generated formulas: their tables, their store on disk, the composition of their kernels."""
