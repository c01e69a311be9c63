"""From depth frames to pose measurements: returns -> planes -> segments -> rectangles -> faces."""
