"""Shapes of arrays in annotations, in jaxtyping's notation; jaxtyping itself is for type checkers and is not loaded."""

from typing import TYPE_CHECKING

import numpy as np
from jax import Array as Array
from numpy.typing import ArrayLike as ArrayLike  # JAX's has no lists of numbers

if TYPE_CHECKING:
    from jaxtyping import Bool as Bool
    from jaxtyping import Float as Float
    from jaxtyping import Int as Int
else:

    class Float:
        """`Float[Array, "n"]` is `Array`."""

        def __class_getitem__(cls, array_and_shape):
            return array_and_shape[0]

    Bool = Int = Float

AnyArray = Array | np.ndarray  # JAX's or NumPy's
Number = float | np.floating | Float[Array, ""]  # compiled in as a float, a parameter as an array
