"""The filter engine, its batched form and the fit of whole arcs; they know no satellite."""
