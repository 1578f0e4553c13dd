"""Loop closures: found, registered, and their errors measured."""
