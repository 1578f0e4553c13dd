"""Monte Carlo labels of whole surveys: kept as they are made, checked, and varied."""
