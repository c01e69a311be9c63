"""Arrays, rotations and transforms, cameras, statistics: array in, array out, no files."""
