"""A survey made ready: what is read, how it is cut, and what is known beside it."""
