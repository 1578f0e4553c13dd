"""The report on the errors of loop closures."""
