"""Blind PnP, or simultaneous pose and correspondence: the protocols of the literature, and baselines that run here."""
