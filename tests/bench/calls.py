"""`python -m tests.bench.calls`: files and Python calls of cnclik in a first `ck.solve` of a Panda, but for imports."""

import collections
import pathlib
import sys
import tempfile

import numpy as np

import cnclik as ck

PACKAGE = str(pathlib.Path(ck.__file__).parent)


def counted(fn) -> collections.Counter:
    """Return {(file, function): calls} of the package's own frames while fn() runs."""
    calls = collections.Counter()

    def note(frame, event, _):
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGE) and code.co_name != "<module>":
            calls[code.co_filename.removeprefix(PACKAGE + "/"), code.co_qualname] += 1

    sys.setprofile(note)
    try:
        fn()
    finally:
        sys.setprofile(None)
    return calls


def first_solve():
    """Run the first loop of a process: robot, law, reference, 50 steps."""
    q0 = np.array([0.0, -0.8, 0.0, -2.4, 0.0, 1.6, 0.8])
    law = ck.Law(ck.panda(), ck.pose(), alpha=5.0, inverse=ck.damped(1e-3))
    goal = ck.forward(law.chain, q0 + 0.1)
    return ck.solve(law, ck.hold(goal.position, goal.rotation), q0, 0.01, 50)


def main():
    with tempfile.TemporaryDirectory() as folder:
        ck.use_cache(folder)
        calls = counted(first_solve)
    for (file, name), count in calls.most_common(60):
        print(f"{count:7,} {file} {name}")
    print(f"{calls.total():7,} calls in {len({file for file, _ in calls})} files")


if __name__ == "__main__":
    main()
