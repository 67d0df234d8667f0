"""Problems made of equations: elimination, checks, and generated formulas."""
