"""Speed, accuracy against peers and memory, measured in one run: ``python -m benchmarks``.

Nothing here asserts on seconds; what may be quoted are ratios between methods of the same run.
"""
