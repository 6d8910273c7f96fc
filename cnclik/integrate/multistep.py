"""Multistep: one evaluation of f a step, and a memory of the steps before.

  q[k+1] = Σⱼ aⱼ q[k−j] + Ts Σⱼ bⱼ f[k−j]

Adams-Bashforth formulas remember slopes, the Taylor-type formulas of the zeroing-neural-network literature joint
values. How large z = alpha·Ts may be follows from the roots of λᵖ = Σⱼ (aⱼ − z bⱼ) λᵖ⁻¹⁻ʲ, see
`cnclik.stability.linear`.
"""

import dataclasses

import jax

# bⱼ by their number (Bashforth & Adams 1883; Hairer, Nørsett & Wanner 1993, III.1).
ADAMS = {
    1: (1.0,),
    2: (3 / 2, -1 / 2),
    3: (23 / 12, -16 / 12, 5 / 12),
    4: (55 / 24, -59 / 24, 37 / 24, -9 / 24),
}


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True, kw_only=True)
class Multistep:
    """An explicit linear multistep method, compiled in.

    Attributes:
      name: as written in the API, on the command line and in datasets.
      a: weights of q[k], q[k−1], …; their sum is 1.
      b: weights of the slopes f[k], f[k−1], ….
      order: the order of accuracy on a moving target.
      source: where it comes from.
      exponential: whether the error decays by its exact factor, and the memory is of J# and ẋ_d: see
        `cnclik.integrate.remember`.
    """

    name: str
    a: tuple = (1.0,)
    b: tuple
    order: int
    source: str
    exponential: bool = False

    def __repr__(self):
        return self.name

    @property
    def implicit(self) -> bool:
        """Never: for the sake of one name for all methods."""
        return False

    @property
    def steps(self) -> int:
        """How many instants the formula uses, the present one among them."""
        return max(len(self.a), len(self.b))

    @property
    def table(self) -> tuple:
        """(a, b), both of `steps` weights, by how many instants before the present one are remembered.

        With all of them it is the formula itself; with fewer, Adams-Bashforth of rising order up to its own.
        """
        rising = [((1.0,), ADAMS[min(past + 1, self.order)]) for past in range(self.steps - 1)]
        return tuple(tuple(_filled(w, self.steps) for w in row) for row in (*rising, (self.a, self.b)))


def _filled(weights, count):
    return (*weights, *(0.0,) * (count - len(weights)))


def _adams(p):
    return Multistep(name=f"AB{p}", b=ADAMS[p], order=p, source="Bashforth & Adams (1883)")


AB2, AB3, AB4 = map(_adams, (2, 3, 4))
_TAYLOR = "Taylor-type difference of the zeroing-neural-network literature, "
ZNN4 = Multistep(name="ZNN4", a=(3 / 2, -1.0, 1 / 2), b=(1.0,), order=2, source=_TAYLOR + "four instants; z up to 1")
ZEAD4 = Multistep(
    name="ZEAD4", a=(3 / 5, 1 / 5, 1 / 5), b=(8 / 5,), order=2, source=_TAYLOR + "four instants; z up to 1"
)
ZNN6 = Multistep(
    name="ZNN6",
    a=(6 / 13, 2 / 13, 4 / 13, 3 / 13, -2 / 13),
    b=(24 / 13,),
    order=3,
    source=_TAYLOR + "six instants; z up to 2/3",
)
IFD5 = Multistep(
    name="IFD5",
    a=(-1 / 8, 3 / 4, 5 / 8, -1 / 4),
    b=(9 / 4,),
    order=3,
    source=_TAYLOR + "five instants; z up to 0.281",
)
