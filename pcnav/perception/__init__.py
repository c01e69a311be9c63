"""From depth frames to recognised rectangles: returns -> planes -> rectangles -> pose measurements."""
