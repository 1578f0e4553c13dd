"""The authors' published arrays: read without trusting them, as tables."""
