"""What a raw file holds, before anything is computed from it: facts, their text, and two plots."""
