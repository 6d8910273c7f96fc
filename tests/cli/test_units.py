"""Numbers with a unit on the command line."""

import math

import pytest

from cnclik import quantities
from cnclik.cli import arguments, diagnose, reach, solve, stability
from cnclik.problem.options import OPTIONS, in_own_units

NUMBERS = [  # verb, arguments, option, values
    (solve, "--delay 34ms --Ts 4ms", "delay", 8.5),
    (solve, "--Ts 4 ms --delay 34 ms", "delay", 8.5),
    (solve, "--delay=2samples", "delay", 2.0),
    (solve, "--Ts 500µs", "Ts", 5e-4),
    (solve, "--lag 20ms 30ms", "lag", (0.02, 0.03)),
    (solve, "--q0 0 -90 90 deg", "q0", (0, -math.pi / 2, math.pi / 2)),
    (solve, "--q0 -90 45 deg 100 mm", "q0", (-math.pi / 2, math.pi / 4, 0.1)),
    (solve, "--q0 0 0.5 -1", "q0", (0, 0.5, -1)),
    (solve, "--target 300 -300 500 mm 1 0 0 0", "target", (0.3, -0.3, 0.5, 1, 0, 0, 0)),
    (solve, "--speed 500mm/s", "speed", 0.5),
    (solve, "--natural-frequency 5Hz", "natural_frequency", 10 * math.pi),
    (reach, "--random 1 --near 90deg 100 mm", "near", (math.pi / 2, 0.1)),
    (stability, "--speed 100mm/s", "speed", 0.1),
    (diagnose, "--Ts 2ms", "Ts", 2e-3),
]


@pytest.mark.parametrize(("verb", "argv", "name", "wanted"), NUMBERS)
def test_a_number_may_have_a_unit(verb, argv, name, wanted):
    place = "log.csv" if verb is diagnose else "panda"
    made = arguments.parse(verb, [place, *(argv.split() if isinstance(argv, str) else argv)], prog="", description="")
    shared = {key: value for key, value in made.items() if isinstance(value, quantities.Quantities) and key in OPTIONS}
    assert (made | in_own_units(shared))[name] == pytest.approx(wanted, rel=1e-12)


def test_a_number_read_aloud_has_at_most_three_digits():
    """A wall was missed by "1e+03 mm/s"."""
    said = [quantities.aloud(v, "m") for v in (0.99996, -0.0009999, 9.996e-7, 0.0123, 3e-10, 0.0)]
    assert said == ["1 m", "-1 mm", "1 µm", "12.3 mm", "3e-10 m", "zero"]
    said = [quantities.aloud(0.00123, unit) for unit in ("rad/s, m/s", "1", "", "1/s")]
    assert said == ["0.00123 rad/s, m/s", "0.00123", "0.00123", "0.00123 1/s"]
