"""The basis of every stage: parameters, artifacts, workers, errors."""
