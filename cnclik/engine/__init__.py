"""Engine: a function that JAX traces, as a program in C that the system's compiler builds.

`reader` reads the trace into a `graph` of scalars (`algebra`; rules in `arrays`, `matrices`, `places`, `regions`, and
`stacks` for what scans stack up, `residuals` for what gradients need of it); `to_c` writes it on vectors of lanes
(`operations`, `row_texts`, `pieces`), `source` the whole file with the C of the folder `c`; `compiler` builds it and
`program` runs it: for a batch, by `lanes`, or inside a JAX program, by `native`.
"""
