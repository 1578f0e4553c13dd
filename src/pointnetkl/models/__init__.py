"""Trained models: what they compute, and the file that holds them."""
