"""Random: JAX's keys, and random numbers drawn with keys that are known only at run time.

A key is a cell of two whole numbers. JAX's own implementation is traced down to whole numbers and `threefry2x32`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.random import threefry_prng_impl as of_keys

from cnclik.engine.cells import array_of, moved
from cnclik.engine.graph import Node, UnsupportedError
from cnclik.engine.operations import TYPES
from cnclik.record import bits_of

MOST = 64  # numbers drawn at once, at most: each takes a hundred operations
_TURNS = ((13, 15, 26, 6), (17, 29, 16, 24))
_DRAWN = {
    "random_seed": lambda p, seed: of_keys.seed(seed),
    "random_fold_in": lambda p, key, data: of_keys.fold_in(key, data),
    "random_split": lambda p, key: of_keys.split(key, p["shape"]),
    "random_bits": lambda p, key: of_keys.random_bits(key, p["bit_width"], p["shape"]),
    "random_wrap": lambda p, key: key,
    "random_unwrap": lambda p, key: key,
}


class Key(NamedTuple):
    """A cell that is a key."""

    one: Node
    other: Node

    known = False


def drawn(reader, eqn, inputs) -> list:
    if (found := moved(eqn, inputs)) is not None:
        return found
    (out,), name = (v.aval for v in eqn.outvars), eqn.primitive.name
    avals = [v.aval for v in eqn.invars]
    keys = [a for a in (*avals, out) if is_key(a)]
    if name not in _DRAWN or any((a.ndim and a is not out) or str(a.dtype) != "key<fry>" for a in keys):
        raise UnsupportedError(f"the operation `{name}` has no C form")
    if out.size > MOST:
        raise UnsupportedError(f"{out.size} random numbers at once have no C form")
    inputs = [array_of([*x.item()], (2,)) if is_key(a) else x for x, a in zip(inputs, avals, strict=True)]
    avals = [jax.ShapeDtypeStruct((2,), np.uint32) if is_key(a) else a for a in avals]
    (made,) = traced(lambda *x: _DRAWN[name](eqn.params, *x))(reader, avals, *inputs)
    return [array_of([Key(*pair) for pair in made.reshape(-1, 2)], out.shape) if is_key(out) else made]


def as_cell(reader, key):
    pairs = bits_of(key).reshape(-1, 2)
    return array_of([Key(*(reader.g.const(x, x.dtype) for x in pair)) for pair in pairs], key.shape)


def is_key(aval) -> bool:
    return jax.dtypes.issubdtype(aval.dtype, jax.dtypes.extended)


def check_dtype(dtype):
    """Raises UnsupportedError if numbers of a type have no C form."""
    if jax.dtypes.issubdtype(dtype, jax.dtypes.extended) or np.dtype(dtype).name not in TYPES:
        raise UnsupportedError(f"numbers of type {dtype} have no C form")


def traced(fn):
    """A rule that reads what `fn` does in JAX."""

    def rule(reader, avals, *inputs):
        closed = jax.make_jaxpr(fn)(*(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals))
        return reader.run(closed.jaxpr, closed.consts, list(inputs))

    return rule


def _threefry(key, other, x, y):
    """Threefry of two words in 20 rounds (Salmon, Moraes, Dror & Shaw 2011)."""
    keys = key, other, key ^ other ^ np.uint32(0x1BD11BDA)
    x, y = x + keys[0], y + keys[1]
    for i in range(5):
        for turn in _TURNS[i % 2]:
            x = x + y
            y = ((y << np.uint32(turn)) | (y >> np.uint32(32 - turn))) ^ x
        x, y = x + keys[(i + 1) % 3], y + keys[(i + 2) % 3] + np.uint32(i + 1)
    return x, y


# erf⁻¹(x) = x p(w), w = −log(1 − x²) (Giles 2010), as in XLA: (upper bound of w, shift of w, coefficients).
_SINGLE = (
    (5.0, 2.5, "2.81022636e-08 3.43273939e-07 -3.5233877e-06 -4.39150654e-06 0.00021858087 -0.00125372503"
               " -0.00417768164 0.246640727 1.50140941"),
    (None, 3.0, "-0.000200214257 0.000100950558 0.00134934322 -0.00367342844 0.00573950773 -0.0076224613 0.00943887047"
                " 1.00167406 2.83297682"),
)  # fmt: skip
_DOUBLE = (
    (6.25, 3.125, "-3.6444120640178197e-21 -1.685059138182016589e-19 1.2858480715256400167e-18 1.115787767802518096e-17"
                  " -1.333171662854620906e-16 2.0972767875968561637e-17 6.6376381343583238325e-15"
                  " -4.0545662729752068639e-14 -8.1519341976054721522e-14 2.6335093153082322977e-12"
                  " -1.2975133253453532498e-11 -5.4154120542946279317e-11 1.051212273321532285e-09"
                  " -4.1126339803469836976e-09 -2.9070369957882005086e-08 4.2347877827932403518e-07"
                  " -1.3654692000834678645e-06 -1.3882523362786468719e-05 0.0001867342080340571352"
                  " -0.00074070253416626697512 -0.0060336708714301490533 0.24015818242558961693 1.6536545626831027356"),
    (16.0, 3.25, "2.2137376921775787049e-09 9.0756561938885390979e-08 -2.7517406297064545428e-07"
                 " 1.8239629214389227755e-08 1.5027403968909827627e-06 -4.013867526981545969e-06"
                 " 2.9234449089955446044e-06 1.2475304481671778723e-05 -4.7318229009055733981e-05"
                 " 6.8284851459573175448e-05 2.4031110387097893999e-05 -0.0003550375203628474796"
                 " 0.00095328937973738049703 -0.0016882755560235047313 0.0024914420961078508066"
                 " -0.0037512085075692412107 0.005370914553590063617 1.0052589676941592334 3.0838856104922207635"),
    (None, 5.0, "-2.7109920616438573243e-11 -2.5556418169965252055e-10 1.5076572693500548083e-09"
                " -3.7894654401267369937e-09 7.6157012080783393804e-09 -1.4960026627149240478e-08"
                " 2.9147953450901080826e-08 -6.7711997758452339498e-08 2.2900482228026654717e-07"
                " -9.9298272942317002539e-07 4.5260625972231537039e-06 -1.9681778105531670567e-05"
                " 7.5995277030017761139e-05 -0.00021503011930044477347 -0.00013871931833623122026"
                " 1.0103004648645343977 4.8499064014085844221"),
)  # fmt: skip


def _erf_inv(x):
    w = -jnp.log1p(-x * x)
    made, root = None, jnp.sqrt(w)
    for below, less, numbers in reversed(_DOUBLE if x.dtype == np.float64 else _SINGLE):
        at = (w if made is not None and below in (5.0, 6.25) else root) - less
        p = jnp.zeros_like(x)
        for c in map(float, numbers.split()):
            p = c + p * at
        made = p if below is None else jnp.where(w < below, p, made)
    return jnp.where(jnp.abs(x) == 1, x * jnp.inf, made * x)


def _rule(fn):
    made = traced(fn)
    return lambda reader, eqn, *inputs: made(reader, [v.aval for v in eqn.invars], *inputs)


RANDOM = {"threefry2x32": _rule(_threefry), "erf_inv": _rule(_erf_inv)}
