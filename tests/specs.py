"""One small sweep in words: a planar arm that reaches for a point that holds still."""

TEXT = """
question = "Does it end well?"
expectation = "It does."
metrics = {metrics}
{more}
[fixed]
task = "xy"
robot = "planar:1,1"
q0 = [0, "-pi/2"]
N = {N}
reference = "hold"
target = [1, 0]
[axes]
{axes}
"""


def reaching(metrics, N=5, more="", **axes) -> str:
    """The sweep's TOML: its metrics, steps, further lines at the top, and {axis: values} as TOML writes them."""
    written = "\n".join(f"{name} = {values}" for name, values in axes.items())
    return TEXT.format(metrics=metrics, N=N, more=more, axes=written)
