"""Engine: a function that JAX traces, as a program in C that the system's compiler builds.

`reader` reads the trace into a `graph` of scalars, simplified by `algebra`; its rules are in `arrays`, `matrices`,
`places` and `regions`, in `stacks` and `over_rows` for what scans stack up, and in `residuals` for what gradients need
of it. `to_c` writes the graph on vectors of lanes (`operations`, `row_texts`, `pieces`), `scalar` as C99 of one lane,
`source` the whole file with the C of the folder `c`; `compiler` builds it, and `program` runs it for a batch, `native`
inside a JAX program.
"""

from cnclik.record import register_waiting

register_waiting()  # from here on JAX is needed
