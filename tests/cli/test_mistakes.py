"""The mistakes that a new user made, each with the line that answers it: on stderr, alone, with exit code 2."""

import pytest

from cnclik.cli import main

SIX = ["--q0", "0", "-1", "1", "0", "1", "0"]
FILES = {
    "two.urdf": """<robot name="two"><link name="base"/><link name="left"/><link name="right"/>
    <joint name="a" type="continuous"><parent link="base"/><child link="left"/></joint>
    <joint name="b" type="prismatic"><parent link="base"/><child link="right"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1" velocity="1"/></joint></robot>""",
    "way.csv": "time,x,y,zz\n0,0.3,0,0.4\n1,0.3,0.1,0.4\n",
    "semicolons.csv": "0;0.3;0;0.4\n1;0.3;0.1;0.4\n",
    "text.txt": "no robot",
    "log.csv": "t,q1\n0,0\n0.01,1\n0.02,2\n",
    "stack.csv": "stamp,a.x,b.x\n" + "".join(f"{k},{'inf' if k == 2 else k},{k * k}\n" for k in range(20)),
    "back.csv": "stamp,q\n" + "".join(f"{-0.1 * k},{k}\n" for k in range(20)),
    "bare.csv": "q\n1\n2\n",
    "times.csv": "t\n0\n1\n",
}
MISTAKES = [
    ("sovle panda", "Argument `verb` must be one of", "(did you mean 'solve'?)."),
    ("solve", "Argument `ROBOT` must be given, but is not: A URDF or MJCF file; panda; ur5"),
    ("solve pandda", "must be a URDF or MJCF file, panda, ur5, planar:1,1,1", "(did you mean 'panda'?)."),
    ("solve two.urdf", "Option `--tip` must be given for two.urdf, such as left, right, but is not."),
    ("solve two.urdf --tip lefft", "Option `--tip` must be", "(did you mean 'left'?)."),
    ("solve panda --tip hand", "Option `--tip` must be left out for the robot 'panda', but is 'hand'."),
    ("solve panda -a 5", "Unknown option -a;"),
    ("solve panda --alpa 5", "Unknown option --alpa; did you mean --alpha?"),
    ("solve panda --gain 5", "Unknown option --gain; did you mean --alpha?"),
    ("solve panda --dt 0.01", "Unknown option --dt; did you mean --Ts?"),
    ("solve panda --alpha", "Option `--alpha` must be given numbers, but has no value."),
    ("solve panda --Ts 0,01", "but is '0,01': write 0.01."),
    ("solve panda ur5", "'ur5' is one too many; `cnclik solve --help` lists the options."),
    ("solve panda --Ts 5 kg", "Option `--Ts` must be a number, but is '5 kg'."),
    ("solve panda --N 3 --N 4", "Option `--N` must be given once, but is given twice."),
    ("solve panda --json=yes", "Unknown option --json=yes; did you mean --json?"),
    ("solve panda --N 1.5", "Option `--N` must be an integer, but is '1.5'."),
    (["solve", "panda", *SIX, "nan"], "Option `--q0` must be finite, but is nan at index (6,)."),
    ("solve ur5 --q0 0 -90 90deg 0 0 0", "write a unit behind each number, or once at the end, apart"),
    ("solve panda --target 0.3 0.1", "Option `--target` must have 3 or 7 numbers (x y z [m]", "but has 2."),
    ("solve planar:1,1 --target 300 400 --begin on-path", "millimetres are written with their unit."),
    ("solve panda --task xyzz", "Option `--task` must be pose, position, orientation, or coordinates such as xy"),
    ("solve panda --reference cirle", "Option `--reference` must be one of hold", "(did you mean 'circle'?)."),
    ("solve panda --reference way.csv", "must have columns time x y z, but way.csv has time x y zz."),
    ("solve panda --reference semicolons.csv", "separated by commas, but semicolons.csv holds '0;0.3;0;0.4'"),
    ("solve panda --delay 150 --lag 20ms", "Option `--delay` must be at most 101 samples"),
    ("stability --damping-ratio 0.7", "Option `--damping-ratio` must come with a natural_frequency"),
    ("solve panda --q0 0 90 dog", "numbers, but is '0 90 dog' (units: m, cm, mm, um, rad, mrad, deg)"),
    ("reach panda", "One of TARGETS, --target X Y Z and --random N must be given, but there is none"),
    ("reach planar:1,1 text.txt", "`TARGETS` must end with .csv, but is 'text.txt'"),
    ("reach planar:1,1 --random 3 --out x.txt", "`--out` must end with .csv"),
    ("reach panda --random 3 --path --near 0 0 0 0 0 0 0", "Option `--near` must be left out with --path"),
    ("stability --natural-frequency 30 20 --damping-ratio 1 1 1", "`--damping-ratio` must be a single number or have"),
    ("stability --draw chart", "Option `--draw` must be some of gains, plane, map, but is 'chart'."),
    ("stability --out figures", "Option `--out` must come with --draw, but comes without."),
    ("stability --task xy", "Option `--task` must come with ROBOT or --draw map, but comes without."),
    ("solve panda --smoothed command", "`--smoothed` must come with a smoothing or a cutoff, but comes without."),
    ("stability --smoothed command", "`--smoothed` must come with a smoothing or a cutoff, but comes without."),
    ("stability --speed -1", "Option `--speed` must be at least 0, but is -1."),
    ("sweep study.toml --distributed here", "must be auto or HOST:PORT:PROCESSES:PROCESS, but is 'here'"),
    ("export panda", "Option `--out` must be given, but is not."),
    ("diagnose log.csv --tasks a", "Option `--tasks` must have columns such as a.x in LOG"),
    ("diagnose stack.csv --tasks a --alpha 5", "`--alpha` must be left out with --tasks"),
    ("diagnose stack.csv --tasks a b a=3", "Option `--tasks` must name each task once, but is a b a=3."),
    ("diagnose stack.csv --tasks a b --columns a.x", "have columns such as b.x in LOG, but is 'b', and LOG has a.x."),
    ("diagnose stack.csv --tasks a --step", "`--step` must be left out with --tasks"),
    ("diagnose log.csv --command velocity", "Option `--command` must come with --step"),
    ("diagnose stack.csv --tasks b=-3", "must be positive, but is -3"),
    (["diagnose", "log.csv", "--out", ""], "Option `--out` must be given a text, but has no value."),
    (["diagnose", "log.csv", "--Ts", "1 2"], "Option `--Ts` must be a number, but is '1 2'."),
    ("diagnose log.csv --columns q3", "Option `--columns` must be one of t, q1, but is 'q3'"),
    ("diagnose log.csv --step --columns q1", "Option `--columns` must name as many motions as commands"),
    ("diagnose log.csv --step", "must name commands, then motions, but is left out, and LOG has t, q1."),
    ("diagnose times.csv", "Argument `LOG` must have a column besides the times, but has none."),
    ("diagnose log.csv", "Argument `LOG` must have at least 16 rows, but has 3."),
    ("diagnose stack.csv --columns b.x a.x", "must hold a finite number in every row of its columns, but"),
    ("diagnose back.csv", "Argument `stamp` must increase, but the median step is -0.1 s."),
    ("check back.csv", "Argument `stamp` must increase, but the median step is -0.1 s."),
    ("check log.csv --Ts 1e308", "Option `--Ts` must be within ±1e+30, but reaches 1e+308."),
    ("diagnose bare.csv", "Option `--Ts` must be given where no column is called t, time or stamp"),
    ("diagnose two.urdf", "Argument `LOG` must hold numbers, but two.urdf holds none."),
    ("check log.csv --limits pandda", "must be one of panda, fr3, FILE.csv, but", "(did you mean 'panda'?)."),
    ("reach panda --target 0.3 0 0.4", "a quaternion w x y z, but holds 3, as for the task position."),
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda m: m[0] if isinstance(m[0], str) else " ".join(m[0]))
def test_a_mistake_gets_one_helpful_line(mistake, tmp_path, monkeypatch, capsys):
    argv, *words = mistake
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(argv.split() if isinstance(argv, str) else argv)
    said = capsys.readouterr()
    assert left.value.code == 2 and said.out == "" and said.err.count("\n") == 1, said.err
    assert said.err.startswith("cnclik: ") and all(word in said.err for word in words), said.err
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)  # nothing was begun
