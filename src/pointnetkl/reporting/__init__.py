"""The report: numbers, tables, figures and words from every stage's artifacts."""
