"""A survey closed from its own navigation: how navigation drifts, closures found and judged, poses solved."""
