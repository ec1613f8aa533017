"""Steps batches in machine code that is made from their NumPy functions; see README.md."""
