"""Loop closures: search, registration, and measurement of their errors."""
