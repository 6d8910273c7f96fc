"""Tracing: what JAX's traces depend on: the engine that the user has chosen, whether the engine reads, a model's zeros.

The first two are part of JAX's cache keys. They are made together: each such context that JAX gets later makes it
compile anew what a user has compiled before.
"""

import jax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

engine = jax.make_user_context(default_value=None)  # a name in `cnclik.engine.plan.ENGINES`; None: the quickest
_read = jax.make_user_context(default_value=False)


def to_be_read():
    """Context manager: the engine reads what is traced inside."""
    return _read(True)


def is_read() -> bool:
    """Whether the engine reads what is being traced."""
    return _read.value


def checkpointed(step):
    """`jax.checkpoint` of a loop's step, for XLA only; the engine finds itself what a gradient should store."""
    return step if _read.value else jax.checkpoint(step, prevent_cse=False, static_argnums=0)


def together(fn, x):
    """fn of each row of x: by XLA of all at once, in the engine's programs one after the other."""
    return jax.lax.map(fn, x) if _read.value else jax.vmap(fn)(x)


model_p = Primitive("cnclik_model")
model_p.def_impl(lambda x: x)
model_p.def_abstract_eval(lambda x: x)
mlir.register_lowering(model_p, lambda _, x: [x])
batching.primitive_batchers[model_p] = lambda args, dims: (model_p.bind(*args), dims[0])
ad.primitive_jvps[model_p] = lambda primals, tangents: (model_p.bind(*primals), tangents[0])


def of_the_model(tree):
    """The tree with its arrays marked as constants of a model: numbers that are never infinity or NaN.

    In JAX 0 times infinity is NaN, so a program must multiply by each 0 of a matrix. A robot's geometry is full of
    zeros: marked, they vanish from the engine's programs, with all that is multiplied by them. Everywhere else the mark
    changes nothing, derivatives included.
    """
    return jax.tree.map(model_p.bind, tree)
