"""What is measured: one `Line` of the table, the lines of the usual table, and those that filters ask for."""

import dataclasses
import itertools

from cnclik import errors
from cnclik.integrate.method import METHODS

STAGES = ("picard", "chord", "newton")
ROBOTS = ("planar2", "planar5", "panda", "ur5", "chain30")  # `cases` says what they are; it needs JAX
AXES = {  # None: the usual one
    "robot": ROBOTS,
    "method": ("EE", "IE", "CN", "TRAPEZOID"),
    "stage": (None,),
    "M": (5,),
    "dtype": ("float32", "float64"),
    "batch": (1, 64, 4096, 1_000_000),
    "cores": (None,),
}
EXPONENTIAL = ("EXP-EE", "EXP-MIDPOINT")  # measured on the usual robot alone


@dataclasses.dataclass(frozen=True, kw_only=True)
class Line:
    """What one line of the table measures. `cores` None: all this process may use; `N` None: chosen by cost."""

    robot: str
    method: str
    stage: str
    M: int = 5
    dtype: str = "float32"
    batch: int = 4096
    cores: int | None = None
    N: int | None = None
    gradient: bool = False

    def __str__(self):
        """In words: "panda CN picard(5) float32 batch 4096"."""
        cores = "" if self.cores is None else f" cores {self.cores}"
        return f"{self.robot} {self.method} {self.stage}({self.M}) {self.dtype} batch {self.batch}{cores}"

    def __post_init__(self):
        errors.one_of("robot", self.robot, ROBOTS)
        errors.one_of("method", self.method, METHODS)
        errors.one_of("stage", self.stage, STAGES)
        errors.one_of("dtype", self.dtype, AXES["dtype"])
        errors.integer("M", self.M, at_least=0)
        errors.integer("batch", self.batch, at_least=1)
        if self.N is not None:
            errors.integer("N", self.N, at_least=1)
        if self.cores is not None:
            from cnclik.threads import cores as here

            errors.integer("cores", self.cores, at_least=1)
            if self.cores > here():
                raise errors.fail("cores", f"be at most {here()} on this machine", f"is {self.cores}")


def stage_of(method: str) -> str:
    """How a method's implicit stage is solved unless told otherwise: by picard, as in the paper, TRAPEZOID by chord."""
    return "chord" if method == "TRAPEZOID" else "picard"


def table() -> list[Line]:
    """The lines through Panda, EE, float32, batch 4096 along each axis, and a few more; some with gradients.

    The whole product would take most of an hour, mostly for compiling.
    """

    from cnclik.threads import cores as here

    def line(robot="panda", method="EE", **rest):
        return Line(robot=robot, method=method, stage=stage_of(method), **rest)

    made = [
        line(robot, method, gradient=robot in ("planar5", "panda") and method in ("EE", "CN"))
        for robot, method in itertools.product(AXES["robot"], AXES["method"])
    ]
    made += [line(method=method) for method in EXPONENTIAL]
    made += [line(dtype=dtype, batch=batch) for dtype, batch in itertools.product(AXES["dtype"], AXES["batch"])]
    made += [line("panda", "CN", dtype="float64"), line("panda", "CN", batch=1_000_000)]
    made += [line("planar5", "CN", batch=1_000_000)]
    made += [line(batch=65536, cores=cores) for cores in _powers_up_to(here())]
    different = {}
    for one in made:
        different.setdefault(dataclasses.replace(one, gradient=False), one)
    return list(different.values())


def _powers_up_to(count) -> list:
    """1, 2, 4, ... and `count` itself; nothing where there is only one core."""
    return sorted({count, *(2**i for i in range(count.bit_length()) if 2**i < count)}) if count > 1 else []


def product(*, N=None, gradient=False, **some) -> list[Line]:
    """Every combination of `some` values of `AXES`; an axis without any takes all of the table's, or the usual one."""
    axes = AXES | {name: values for name, values in some.items() if values}
    made = (dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values()))
    return [Line(**one | {"stage": one["stage"] or stage_of(one["method"])}, N=N, gradient=gradient) for one in made]


# --- what came out, as a table ------------------------------------------------------------------------

WORDS = ("robot", "method", "stage", "dtype")
NUMBERS = ("batch", "cores", "N", "M eval/s", "± %", "run", "compile [s]", "peak [MiB]", "∂q0 ×", "∂alpha ×")


def row(record: dict) -> list[str]:
    """The cells of one measured line, under `WORDS` and `NUMBERS`."""
    ratios = record.get("gradient_over_forward"), record.get("alpha_gradient_over_forward")
    return [
        *(record["robot"], record["method"], f"{record['stage']}({record['M']})", record["dtype"]),
        *(f"{record['batch']:,}", str(record["cores"]), str(record["N"])),
        f"{record['evaluations_per_second'] / 1e6:.3g}",
        f"{50 * record['spread']:.0f}",
        _time(record["run_s"]),
        *(f"{record['compile_s']:.1f}", f"{record['peak_mib']:.0f}"),
        *("" if ratio is None else f"{ratio:.1f}" for ratio in ratios),
    ]


def _time(seconds):
    unit, size = ("s", 1.0) if seconds >= 1 else ("ms", 1e-3) if seconds >= 1e-3 else ("µs", 1e-6)
    return f"{seconds / size:.3g} {unit}"
