"""Files that are whole or not there, and tables of numbers in them."""
