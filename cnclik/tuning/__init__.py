"""Gains by gradient, stability as a constraint."""
