"""Sines: sine and cosine together in C, by one range reduction and two short polynomials, within 2 ulp.

|x| = k·π/2 + r with |r| ≤ π/4 (Cody & Waite 1980). π/2 is split into short parts, so that k times each but the last is
exact for |x| ≤ 1e4; contracting a·b + c then changes nothing. sin r and cos r are minimax polynomials with a relative
error of 4e-9 in float32 and 4e-18 in float64. The C library's functions are used beyond this range and for NaN.
"""

import functools

# By the bytes of a number: parts of π/2 whose product with k is exact, then a compensated part, then the tail; S of
# sin r = r + r³ S(r²); C of cos r = 1 − r²/2 + r⁴ C(r²); 2/π; 1.5 times two to the power of the mantissa's bits: what
# is added to it becomes whole.
_TABLES = {
    4: (
        "1.5703125 0.0004837512969970703 7.549533620476723e-08 2.5633441e-12",
        "-0.166666549331917384 0.00833217745665272256 -0.000195172025549268638",
        "0.0416666468486836209 -0.00138873666071656574 0.0000244383434232972141",
        "0.636619772",
        "12582912.0",
    ),
    8: (
        "1.5707963267941523 7.443547480480255e-13 6.36831716351095e-25",
        "-0.16666666666666632 0.0083333333333224082 -0.000198412698298032444 2.75573136902666746e-6"
        " -2.50507578467316194e-8 1.58967795431892491e-10",
        "0.0416666666666665994 -0.00138888888888741166 0.000024801587289477352 -2.75573143508751314e-7"
        " 2.08757230672177435e-9 -1.13596367512304589e-11",
        "0.6366197723675814",
        "6755399441055744.0",
    ),
}


def filled(text, size) -> str:
    """A text in C with its TURNS, MAGIC and REDUCED for numbers of `size` bytes.

    REDUCED makes r and z = r² of x and k, and the polynomials s = S(z) and t = C(z).
    """
    suffix, (half_pi, sine, cosine, turns, magic) = "f" * (size == 4), _TABLES[size]
    *exact, part, tail = (word + suffix for word in half_pi.split())
    lines = [f"x = x - k * {p};" for p in exact]
    lines += [f"r = x - k * {part};", f"r = r + (((x - r) - k * {part}) - k * {tail});", "z = r * r;"]
    for name, numbers in (("s", sine), ("t", cosine)):
        words = [word + suffix for word in reversed(numbers.split())]
        lines.append(f"{name} = {functools.reduce(lambda made, c: f'({made} * z + {c})', words)};")
    text = text.replace("REDUCED", "\n  ".join(lines))
    return text.replace("TURNS", turns + suffix).replace("MAGIC", magic + suffix)
