"""From SymPy equations to a problem (the extra ``symbolic``)."""
