"""Error-state filters: one engine, the motion models and the measurements they are fed."""
