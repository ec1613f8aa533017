"""Laws of the tail, trained and judged by how far they turn a car."""
