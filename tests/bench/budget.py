"""`python -m tests.bench.budget`: what an exported step takes of a microcontroller: flash, stack and cycles.

Built by arm-none-eabi-gcc (with newlib, both from Debian). Cycles are those of the longest way through the
instructions, in which there is no loop. Each counts what Arm's manual of the Cortex-M4 gives it (DDI 0439D, tables 3-1
and 7-1), taken branches as the longest, memory without wait states. Some seconds.
"""

import itertools
import pathlib
import re
import subprocess
import tempfile

import cnclik as ck
from cnclik.measure.files import markdown
from tests.bench import cases

CPUS = {"Cortex-M4": "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16", "Cortex-M7": "-mcpu=cortex-m7 -mfpu=fpv5-sp-d16"}
FLAGS = "-std=c99 -mthumb -mfloat-abi=hard -fno-math-errno -ffunction-sections -fstack-usage"
CLOCK = 168e6  # [Hz], of an STM32F407
_LINE = re.compile(r"^ +[0-9a-f]+:\t[0-9a-f ]+\t(\S+)(?:\t(.*))?$")
_PER = (  # cycles of instructions whose names begin so; the first that fits
    (r"vdiv|vsqrt", 14),
    (r"vfn?m[as]|vn?ml[as]", 3),
    (r"vldm|vstm|vpush|vpop|push|pop|ldm|stm", None),  # 1 and 1 for each register
    (r"vldr|vstr|ldr|str", 2),
    (r"b(l|x|lx|eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?(\.[nw])?$|cbn?z", 4),
    (r"[su]div", 12),
    (r"", 1),
)


def cycles(name, operands) -> int:
    """Of one instruction, at most."""
    found = next(count for start, count in _PER if re.match(start, name))
    if found is not None:
        return found
    registers = re.search(r"\{(.*)\}", operands)[1].split(",")
    spans = [re.findall(r"\d+", one) if "-" in one else one for one in registers]
    count = sum(int(one[1]) - int(one[0]) + 1 if isinstance(one, list) else 1 for one in spans)
    return 1 + count + (3 if "pc" in registers[-1] else 0)


def bound(text, function) -> int:
    """Cycles of the longest way through a function and those of its object that it calls, from `objdump -dr`."""
    body = re.search(rf"<{function}>:\n(.*?)(?:\n\n|\Z)", text, re.DOTALL)[1]
    found: list = []  # [address, name, operands, cycles]
    for line in body.splitlines():
        if (match := _LINE.match(line)) and match[1] != ".word":
            found.append([int(line.split(":")[0], 16), match[1], match[2] or "", cycles(match[1], match[2] or "")])
        elif (called := re.search(r"R_ARM_THM_CALL\s+(\w+)", line)) and f"<{called[1]}>:" in text:
            found[-1][-1] += bound(text, called[1])
    at, after = {one[0]: i for i, one in enumerate(found)}, {}

    def follows(i):
        _, name, operands, _ = found[i]
        aim = re.match(r"([0-9a-f]+) <", operands.split(", ")[-1])
        ends = name.split(".")[0] in ("b", "bx") or (name.startswith("pop") and "pc" in operands)
        jumps = [] if aim is None or name == "bl" else [at[int(aim[1], 16)]]
        return jumps if ends else [i + 1, *jumps]

    order, state = [(0, False)], {}
    while order:
        i, done = order.pop()
        if done:
            after[i] = found[i][-1] + max((after[j] for j in follows(i)), default=0)
        elif i not in state:
            state[i] = True
            order += [(i, True), *((j, False) for j in follows(i))]
        else:
            assert i in after, f"a loop in {function}"
    return after[0]


def measure(law, cpu, option, folder) -> tuple:
    """(bytes of code and constants of a step, with what it needs of libm, bytes of stack, cycles of a step at most)"""
    at = ck.export.c(law, out=folder, method="EE", dtype="float")
    line = f"arm-none-eabi-gcc {CPUS[cpu]} {FLAGS} {option}"
    _run(f"{line} -c clik_step.c -o step.o", at)
    _run(f"{line} -nostartfiles -Wl,-e,clik_step,--gc-sections step.o -lm -o all.elf", at)
    whole, own = (
        int(_run(f"arm-none-eabi-size {file}", at).splitlines()[1].split()[0]) for file in ("all.elf", "step.o")
    )
    uses = dict(line.split(":")[-1].split("\t")[:2] for line in (at / "step.su").read_text().splitlines())
    stack = sum(int(size) for name, size in uses.items() if not name.endswith("defaults"))
    return own, whole, stack, bound(_run("arm-none-eabi-objdump -dr step.o", at), "clik_step")


def _run(line, folder) -> str:
    return subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True, check=True).stdout


def table() -> str:
    """Of a pose step with damping by explicit Euler, in single precision, all parameters at run time."""
    rows = []
    for robot, cpu, option in itertools.product(("panda", "ur5"), CPUS, ("-Os", "-O2")):
        with tempfile.TemporaryDirectory() as folder:
            own, whole, stack, most = measure(cases.case(robot).law, cpu, option, pathlib.Path(folder) / "step")
        counted = (f"{most:,}", f"{1e6 * most / CLOCK:.0f}") if cpu == "Cortex-M4" else ("", "")
        rows.append((robot, cpu, option, f"{own:,}", f"{whole:,}", stack, *counted))
    head = ("arm", "core", "", "step [bytes]", "with libm [bytes]", "stack [bytes]", "cycles, at most")
    return markdown((*head, "at 168 MHz [µs]"), rows, left=3)


if __name__ == "__main__":
    print(table())
