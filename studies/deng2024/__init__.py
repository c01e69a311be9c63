"""Deng 2024: what attitudes alone make observable, and the filter on them."""
