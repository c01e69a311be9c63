"""The typed pipeline file: one module a group of tables."""
