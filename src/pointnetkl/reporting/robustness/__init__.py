"""The report on false loop closures."""
