"""Output without a reader, room or letters; ends by signals: no traceback, and no results lost."""

import os
import signal
import subprocess
import sys

import pytest

# A verb whose work writes a file after its first output.
WORK = """
import signal, sys, time
import cnclik.cli as cli
import cnclik.cli.robots as verb

signal.signal(signal.SIGINT, INTERRUPT)  # the tests themselves may run behind `&`

def run(robot):
    from cnclik.writing import output_folder
    with output_folder(robot) as folder:
        for _ in range(4000):  # more than a pipe holds
            print("µ² → ∞ √2 α·Ts ☃ " + chr(0xDC80), flush=True)
        print("begun", file=sys.stderr, flush=True)
        time.sleep(SLEEP)
        folder.write_text("one.txt", "1")

verb.run = run
sys.argv = ["cnclik", "robots", sys.argv[1]]
cli.main()
"""


def work(sleep=0, interrupt="signal.default_int_handler"):
    return WORK.replace("SLEEP", str(sleep)).replace("INTERRUPT", interrupt)


def command(out, *how, **options):
    words = [sys.executable, "-c", work(*how), str(out)]
    return subprocess.Popen(words, text=True, errors="replace", **options)


def ended(process):
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_a_full_disk_behind_the_output(tmp_path):
    with open("/dev/full", "w") as full:
        code, _, err = ended(command(tmp_path, stdout=full, stderr=subprocess.PIPE))
    assert (code, err) == (1, "cnclik: OSError: [Errno 28] No space left on device\n")


def test_a_reader_that_leaves(tmp_path):
    process = command(tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.readline()
    process.stdout.close()
    err = process.stderr.read()
    assert (process.wait(), err) == (141, "") and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("verb", "fate"), [(["--help"], "full"), (["solve", "--what"], "full"), (["robots", "--help"], "closed")]
)
def test_answers_that_nobody_can_read(verb, fate):
    if fate == "full" and not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full")
    redirect = "> /dev/full" if fate == "full" else ">&-"
    line = f'"{sys.executable}" -m cnclik {" ".join(verb)} {redirect}'
    found = subprocess.run(line, shell=True, stderr=subprocess.PIPE, text=True)
    assert found.stderr.count("\n") <= 1 and "Traceback" not in found.stderr
    wanted = 2 if "--what" in verb else 1 if fate == "full" else 0
    assert found.returncode == wanted


def test_an_encoding_that_lacks_our_letters(tmp_path):
    env = os.environ | {"PYTHONIOENCODING": "ascii:strict", "PYTHONUTF8": "0"}
    found = subprocess.run([sys.executable, "-c", work(), str(tmp_path)], capture_output=True, env=env)
    assert (found.returncode, found.stderr) == (0, b"begun\n")
    assert found.stdout.decode("ascii").splitlines()[0] == "?? ? ? ?2 ??Ts ? ?"


@pytest.mark.parametrize(("sent", "code", "says"), [(signal.SIGTERM, 143, "Terminated"), (signal.SIGINT, 130, "Inter")])
def test_signals_leave_no_half_results(tmp_path, sent, code, says):
    process = command(tmp_path, 10, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr.readline() == "begun\n"
    process.send_signal(sent)
    found, _, err = ended(process)
    assert found == code and err.startswith(f"cnclik: {says}") and err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_an_interrupt_leaves_no_bar_and_a_cursor(tmp_path):
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    process = command(tmp_path, 10, stdout=subprocess.DEVNULL, stderr=theirs)
    os.close(theirs)
    with open(ours, "rb", buffering=0) as terminal:
        shown = terminal.read(100)
        process.send_signal(signal.SIGINT)
        assert process.wait() == 130
        shown += terminal.read(100)
    assert b"\r\x1b[2K\x1b[?25hcnclik: Interrupted; what was complete is kept.\r\n" in shown


def test_a_signal_that_is_ignored_stays_ignored(tmp_path):
    """As a shell has it for what a script runs behind `&`: Ctrl-C is for the script."""
    process = command(tmp_path, 1, "signal.SIG_IGN", stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr.readline() == "begun\n"
    process.send_signal(signal.SIGINT)
    assert ended(process)[0] == 0 and (tmp_path / "one.txt").exists()


def test_a_platform_that_is_not_there():
    words, env = [sys.executable, "-m", "cnclik", "solve", "planar:1,1"], os.environ | {"JAX_PLATFORMS": "quantum"}
    found = subprocess.run(words, capture_output=True, text=True, env=env)
    assert found.returncode == 2 and found.stderr.startswith("cnclik: Argument `JAX_PLATFORMS` must name a platform")
    assert found.stderr.count("\n") == 1
