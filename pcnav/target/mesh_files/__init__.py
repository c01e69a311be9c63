"""From a mesh file, as CAD and modelling programs write them, to one clean mesh of triangles."""
