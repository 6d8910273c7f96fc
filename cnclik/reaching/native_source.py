"""Native source: the search of `search` in C, for many targets, around the traced iteration.

Each lane of a vector works on one target. As soon as that is done the lane takes the next one, so that no lane waits.
All numbers are float64, so that no second program is needed for the last digits.
"""

import pathlib

import jax.numpy as jnp
import numpy as np

from cnclik.engine.routine import INT, Field, read
from cnclik.engine.source import vectors
from cnclik.engine.to_c import Writer
from cnclik.reaching import strategy
from cnclik.reaching.asked import TOUCHING
from cnclik.reaching.result import ReachStatus
from cnclik.reaching.search import SCATTER
from cnclik.reaching.seeds import SETS, SIZE, STRETCHES
from cnclik.reaching.step import Search, iterate
from cnclik.reaching.targets import WIDTH, aims, owners

SEARCH = (pathlib.Path(__file__).parent / "c" / "search.c").read_text(encoding="utf-8")


def native_source(chain, task) -> str:
    """The text: `search` for the targets `first` to `last` - 1 of what `asked` points to, and `along` for a path's."""
    program, real = look_of(chain, task, np.float64), np.dtype(np.float64)
    writer = Writer(program.graph, program.given, program.outs, real, *program.places(lambda _, f: f"s->{f.name}"))
    look = ["static void look(Lanes *s)", "{", *writer.statements(), "}"]
    defined = {"LANE(v, i)": "(v)[i]", "SPLAT": "splat_F64", "LIBM(name)": "name", "ENTRY": "", "VECTORS": ""}
    parts = [vectors(writer, real), *writer.tables, lanes_of(program, "F64", "S32"), *look]
    return "\n".join([*parts, search_source(chain, task, "double", SETS, SIZE, strategy.PLAIN, defined)])


def lanes_of(program, real, whole) -> str:
    fields = [
        f"  {whole if f.kind == INT else real} {f.name}{f'[{f.size}]' * bool(f.shape)};"
        for f in program.inputs["lanes"]
    ]
    return "\n".join(["typedef struct {", *fields, "} Lanes;"])


def search_source(chain, task, real, sets, size, by_near, defined) -> str:
    """The search around `look`, with its numbers.

    Args: real: type of numbers. sets, size: of the seeds. by_near: tries about `near`. defined: what else is defined.
    """
    numbers = defined | {"N": chain.n, "M": task.m, "SETS": sets, "SIZE": size, "SCATTER": SCATTER, "BY_NEAR": by_near}
    numbers |= {"AIMS": len(aims(task)), "OWNERS": ", ".join(map(str, owners(task, chain)))}
    numbers |= {"STRETCHES": len(STRETCHES), "STRETCHED": ", ".join(map(str, STRETCHES))}
    numbers |= {"TOUCHING": TOUCHING, "JUMP": int(ReachStatus.JUMP)}
    numbers |= {name: getattr(strategy, name) for name in strategy.NUMBERS}
    defined = [f"#define {name} {value}" for name, value in numbers.items()]
    return "\n".join([*defined, f"typedef {real} Real;", SEARCH])


def look_of(chain, task, dtype):
    """One iteration: evaluate a posture and step from it; a lane's state goes in and comes out."""
    n, dtype = chain.n, np.dtype(dtype)
    state = [Field("q", (n,)), Field("best", (n,)), Field("squares", (2,))]
    state += [Field(name, ()) for name in ("cost", "steep", "trust")] + [Field("arrived", (), INT)]
    own = [Field("careful", (), INT), Field("low", (n,)), Field("high", (n,)), Field("tolerance", (2,))]
    own += [Field("target", (WIDTH * len(aims(task)),)), Field("roots", (task.m,))]

    def one(q, best, squares, cost, steep, trust, arrived, careful, low, high, tolerance, target, roots):
        zero = jnp.zeros((), dtype)
        at = Search(q, best, squares, cost, steep, trust, zero, arrived != 0)
        weights = None if task.weights is None else roots
        made = iterate(chain, task, at, target, (low, high), tolerance, careful != 0, weights)
        return [made.q, made.best, made.squares, made.cost, made.steep, made.trust, made.arrived.astype(jnp.int32)]

    return read(one, {"lanes": [*state, *own]}, {"lanes": state}, dtype=dtype)
