"""What goes wrong in files and words: numbers and texts that break readers, and slips of a hand or of a disk."""

NUMBERS = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e400", "0", "-0.0", "-1", "1e12", "1e-12", "1e16", "0.1"),
    *("", " ", "0x10", "1_000", "٣", "½", "1,2", "1 2", "1 2 3 4", "--1", "1e", "1j", "true", "None", "9" * 400),
    *("9" * 5000, "1" + "0" * 200_000, "0." + "3" * 10_000, "NaN", "+5", "3.14.15", "1;2", "1e+", "−1"),
)
TEXTS = (
    *(
        "",
        " ",
        "a",
        "[/]",
        "[bold",
        "{}",
        "%s%n",
        "../..",
        "/",
        "/dev/null",
        "\t",
        "a b",
        "a\nb",
        "a\r\nb",
        "é",
        "名前",
    ),
    *(
        "\u202eabc",
        "\ufeff",
        "\u2028",
        "💥",
        "'",
        '"',
        "\\",
        "<&>",
        "`x`",
        "$(x)",
        "${x}",
        "\x1b[31mred",
        "nan",
        "None",
    ),
    *(
        "a" * 300,
        "b" * 70_000,
        "x" * 4096,
        "__import__('os')",
        "0",
        "-",
        "--",
        "=",
        "#",
        "link",
        "world",
        "\x7f",
        "z\u0301",
    ),
)
VALUES = (  # as TOML has them
    *(0, 1, -1, 2, 10**6, 10**9, 10**12, 10**18, 2**63, -(2**63), 10**400, 0.0, -0.0, 0.5, -1.5, 1e308, -1e308, 1e-320),
    *(
        1e12,
        float("nan"),
        float("inf"),
        -float("inf"),
        True,
        False,
        [],
        {},
        [[]],
        [{}],
        [1, "a"],
        [1, [2]],
        [[1, 2], [3]],
    ),
    *([0.1, 0.2], [0.1] * 3, [0.1] * 1000, [float("nan")], [1e308, -1e308], [10**400], ["pi", "-pi/2"], [True], [""]),
    *(
        {"linspace": [0, 1, 3]},
        {"linspace": [0, 1, 1e12]},
        {"linspace": [-1e308, 1e308, 5]},
        {"linspace": ["pi", 1, 3]},
    ),
    *({"geomspace": [1e-320, 1e308, 4]}, {"geomspace": [-1, 1, 3]}, {"geomspace": [1, 10, 10**7]}, {"range": [0, 5]}),
    *({"range": [-5, 5]}, {"range": [1, 10**7]}, {"range": [10**30, 10**30 + 3]}, {"range": [5, 1]}, {"samples": 3}),
    *(
        {"samples": 10**7},
        {"samples": 10**7, "per": "joint"},
        {"samples": 3, "low": -1e308, "high": 1e308},
        {"samples": -1},
    ),
    *({"samples": 2, "low": [0, 0], "high": [1, 1, 1]}, {"samples": 2, "seed": 10**30}, {"samples": 2, "low": "nan"}),
    *({"samples": 2, "per": []}, {"linspace": [0, 1, 3], "range": [0, 1]}, {"linspace": [[0, 0], [1, 1], 4]}, {"a": 1}),
)


def any_of(rng, values):
    """One of them, as it is: NumPy would turn it into something of its own."""
    return values[int(rng.integers(len(values)))]


def chance(rng, share) -> bool:
    return bool(rng.random() < share)


def slipped(rng, text: str) -> str:
    """A text with a slip: a letter lost, doubled or wrong; or another text."""
    k = int(rng.integers(len(text) + 1))
    match int(rng.integers(6)):
        case 0:
            return text[:k] + text[k + 1 :]
        case 1:
            return text[:k] + text[k : k + 1] + text[k:]
        case 2:
            return text[:k] + any_of(rng, "abzNM._-=[](){}*/+\"'# \n0519é\x00") + text[k + 1 :]
        case 3:
            return any_of(rng, TEXTS)
        case 4:
            return any_of(rng, NUMBERS)
        case _:
            return text.swapcase()


def damaged(rng, data: bytes) -> bytes:
    """Bytes as a bad disk leaves them: flipped, cut off, doubled, gone."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        k = int(rng.integers(len(data) + 1))
        end = k + int(rng.integers(1, 60))
        match int(rng.integers(6)):
            case 0 if k < len(data):
                data[k] ^= 1 << int(rng.integers(8))
            case 1:
                del data[k:]
            case 2:
                data[k:k] = data[k:end]
            case 3:
                del data[k:end]
            case 4:
                data[k:end] = rng.bytes(min(end, len(data)) - k) if k < len(data) else b"\x00"
            case _:
                data[k:k] = any_of(rng, (b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"<!--", b"]]>", b"\r", b"&a;", b'"'))
    return bytes(data)
