"""Monte Carlo labels of whole surveys: stored in shards, summarised, and varied."""
