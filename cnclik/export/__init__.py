"""The step as C: for loops and controllers that JAX can not run in."""
