"""The report on the surveys and their submaps."""
