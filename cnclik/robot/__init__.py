"""Geometry: chains, where their tip is, and how it moves."""
