"""Multi-start ascent of the discrete score: the default solver."""
