"""Files that are whole or not there, tables of numbers in them, and tables that people read."""
