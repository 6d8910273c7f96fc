"""tests.bench.budget: cycles of instructions, and of the longest way through them."""

import pytest

from tests.bench.budget import bound, cycles

LISTING = """
00000000 <clik_step>:
   0:\tb530      \tpush\t{r4, r5, lr}
   2:\tee20 0a00 \tvmul.f32\ts0, s0, s0
   6:\td001      \tbeq.n\tc <clik_step+0xc>
   8:\tee80 0a00 \tvdiv.f32\ts0, s0, s0
   c:\tf7ff fffe \tbl\t20 <sine>
\t\t\tc: R_ARM_THM_CALL\tsine
  10:\tbd30      \tpop\t{r4, r5, pc}

00000020 <sine>:
  20:\tee80 0a00 \tvsqrt.f32\ts0, s0
  24:\t4770      \tbx\tlr
  26:\t3f800000 \t.word\t0x3f800000
"""


def test_cycles_are_arms():
    """DDI 0439D: loads and stores 2, of several 1 and 1 each, division and root 14, fused and chained products 3."""
    given = {"vldr": 2, "vadd.f32": 1, "vfma.f32": 3, "vnmls.f32": 3, "vnmul.f32": 1, "vsqrt.f32": 14, "bx": 4, "it": 1}
    assert {name: cycles(name, "") for name in given} == given
    assert cycles("vpush", "{d8-d15}") == 9 and cycles("pop", "{r4, r5, pc}") == 7


def test_the_longest_way_is_counted():
    """The division's way; breaks where a call's cycles or a branch's are left out, and for a loop that is missed."""
    assert bound(LISTING, "clik_step") == 4 + 1 + 4 + 14 + (4 + 14 + 4) + 7
    with pytest.raises(AssertionError, match="a loop in clik_step"):
        bound(LISTING.replace("beq.n\tc <clik_step+0xc>", "beq.n\t2 <clik_step+0x2>"), "clik_step")
