"""Following bodies from frame to frame: a motion filter, and the poses that no frame can tell apart."""
