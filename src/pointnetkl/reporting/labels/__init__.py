"""The report on labels."""
