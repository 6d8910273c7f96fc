"""Native: what JAX traces, as C that the system's compiler builds.

`program` has a function traced and read (`reader`, `arrays`) into a `graph` of `operations`; `scalar` writes that as
C99, `vector` for many lanes at once, after the `prelude`; `compiler` builds it. `evaluate` and `cost` look at a graph.
"""
