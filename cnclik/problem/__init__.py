"""A loop in plain names: one vocabulary and one builder."""
