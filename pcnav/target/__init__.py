"""The target satellite: mesh, facets, rectangles, symmetry, mass, rendered views."""
