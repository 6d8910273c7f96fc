"""Drexler (2016): its experiments under every reading, its claims, its figures."""
