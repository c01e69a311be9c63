"""Reports: page, figures, tables."""
