"""Shapes of arrays in annotations: `Float[Array, "m n"]`, in jaxtyping's notation, for readers and type checkers."""

from typing import Annotated as Bool
from typing import Annotated as Float
from typing import Annotated as Int

import numpy as np
from jax import Array as Array
from numpy.typing import ArrayLike as ArrayLike  # JAX's has no lists of numbers

AnyArray = Array | np.ndarray  # JAX's or NumPy's
Number = float | np.floating | np.integer | Float[AnyArray, ""]  # compiled in as a float, a parameter as an array
