"""What every stage shares: settings, artifacts, workers, errors."""
