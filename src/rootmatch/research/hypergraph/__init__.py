"""Public protocols of hypergraph matching: point sets of a plane, matched by the angles of triangles."""
