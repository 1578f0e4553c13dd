"""False loop closures, and estimators that withstand them."""
