"""How well the submaps of a map agree where they overlap, as numbers and as maps."""
