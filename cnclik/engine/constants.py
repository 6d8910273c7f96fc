"""Constants of a model: numbers that are never infinity or NaN, and whose zeros and ones are exact.

In JAX 0 times infinity is NaN, so a program must multiply by each 0 of a matrix. A robot's geometry is full of zeros.
Marked as constants of the model, they vanish from the engine's programs, with all that is multiplied by them.
"""

import jax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

model_p = Primitive("cnclik_model")
model_p.def_impl(lambda x: x)
model_p.def_abstract_eval(lambda x: x)
mlir.register_lowering(model_p, lambda _, x: [x])
batching.primitive_batchers[model_p] = lambda args, dims: (model_p.bind(*args), dims[0])
ad.primitive_jvps[model_p] = lambda primals, tangents: (model_p.bind(*primals), tangents[0])


def of_the_model(tree):
    """The tree with its arrays marked as constants of the model: in the engine's programs 0 times anything is 0.

    Everywhere else the mark changes nothing, derivatives included.
    """
    return jax.tree.map(model_p.bind, tree)
