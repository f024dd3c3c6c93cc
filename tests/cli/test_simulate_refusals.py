"""`sssfit simulate`: bad input is one sentence and exit code 2, and nothing that was there is lost."""

import os
import signal
import subprocess
import sys
import time

import pytest

from sssfit.cli.main import main
from sssfit.files.output import Output
from sssfit.scenarios import measure, plot

CIRCLE = ["simulate", "circle", "--seeds", "2", "--frames", "51"]
LINE = ["simulate", "line", "--seeds", "2", "--frames", "2", "--texels", "4"]
BATCH = ["simulate", "batch-mean", "--seeds", "2"]
INTERRUPTED = "sssfit: interrupted; outputs are either as before or complete, run again to finish\n"

CSV = {
    "unequal.csv": "time,intensity\n0,1\n1\n",
    "nan.csv": "time,intensity\n0,1\n1,nan\n",
    "inf.csv": "time,intensity\n0,1\n1,inf\n",
    "negative.csv": "time,intensity\n0,1\n1,-2\n",
    "late.csv": "time,intensity\n1,1\n2,1\n",
    "back.csv": "time,intensity\n0,1\n0,1\n",
    "empty.csv": "",
    "header.csv": "time,intensity\n",
    "columns.csv": "t,intensity\n0,1\n",
    "lamp.csv": "time,intensity\n0,1\n1,1\n",
    "profile.csv": "x,irradiance\n0,1\n1,nan\n",
}


def contents(directory):
    """Files with their bytes, and directories."""
    return {
        str(p.relative_to(directory)): p.read_bytes() if p.is_file() else None for p in directory.rglob("*")
    }


@pytest.fixture
def earlier(tmp_path, monkeypatch):
    """A working directory with input files and with an output directory of an earlier run."""
    monkeypatch.chdir(tmp_path)
    for name, text in CSV.items():
        (tmp_path / name).write_text(text)
    out = tmp_path / "out"
    out.mkdir()
    for name in ("manifest.json", "summary.json", "notes.txt"):
        (out / name).write_text("earlier")
    return out


def refused(command, out, capsys):
    """The one line that is printed."""
    before = contents(out)
    assert main([*command, "--out", "out"]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith("sssfit: ") and printed.err.count("\n") == 1
    assert contents(out) == before
    return printed.err[len("sssfit: ") : -1]


def each(names, option, value, message):
    return [([*CIRCLE, "--controller", name, option, value], message) for name in names]


def words(value):
    """The end of a command as a test's name; its message would only repeat it."""
    return " ".join(value[-4:]) if isinstance(value, list) else "refused"


ADAPTIVE = ("spvg", "as", "ocv", "ccv", "unreal", "in_frame")
BAD_CONSTANTS = [
    *each(
        (*ADAPTIVE, "oracle", "fixed"), "--min-spp", "65", "min_spp must not exceed max_spp, got 65 and 64"
    ),
    *each((*ADAPTIVE, "oracle", "fixed"), "--target-variance", "0", "target_variance must be above 0, got 0"),
    *each(ADAPTIVE[3:], "--target-variance", "-1", "target_variance must be above 0, got -1"),
    *each(ADAPTIVE[3:], "--target-variance", "nan", "target_variance must be above 0, got nan"),
    *each(ADAPTIVE, "--alpha", "0", "alpha must be in (0, 1], got 0"),
    *each(ADAPTIVE[3:], "--alpha", "1.001", "alpha must be in (0, 1], got 1.001"),
    *each(ADAPTIVE[3:], "--alpha", "nan", "alpha must be in (0, 1], got nan"),
    *each(("spvg", "ocv"), "--kappa", "-0.1", "kappa must be in [0, 1], got -0.1"),
    *each(("spvg", "ocv"), "--kappa", "1.1", "kappa must be in [0, 1], got 1.1"),
    *each(("spvg", "unreal"), "--min-spp", "0", "min_spp must be at least 1, got 0"),
    *each(("in_frame",), "--min-spp", "1", "min_spp must be at least 2, got 1"),
    # More than a 32-bit number holds.
    *each(("spvg",), "--max-spp", "3000000000", "max_spp must be at most"),
    *each(("fixed",), "--spp", "3000000000", "spp must be at most"),
    *each(("fixed",), "--spp", "0", "spp must be at least 1, got 0"),
    *each(("fixed",), "--spp", "-2", "spp must be at least 1, got -2"),
]
BAD_LIGHT = [
    (["--light", "unequal.csv"], "unequal.csv, row 3: 1 cells for 2 columns; write one cell per column"),
    (["--light", "nan.csv"], "nan.csv, row 3: column 'intensity' has 'nan' where a number belongs"),
    (["--light", "inf.csv"], "inf.csv, row 3: column 'intensity' has 'inf' where a number belongs"),
    (["--light", "negative.csv"], "negative.csv, row 3: intensity is -2; write a number of at least 0"),
    (["--light", "late.csv"], "late.csv, row 2: time begins with 1; begin with 0"),
    (["--light", "back.csv"], "back.csv, row 3: time does not rise"),
    (["--light", "empty.csv"], "empty.csv: the file is empty"),
    (["--light", "header.csv"], "header.csv: there is a header but no data row"),
    (["--light", "columns.csv"], "columns.csv, row 1: there is no column 'time'"),
    (["--light", "missing.csv"], "missing.csv: there is no such file; check the path"),
    (["--light", "lamp"], "--light must be one of static, sine, on_off, candle, or a CSV file, got 'lamp'"),
    (["--frequency", "2"], "--frequency belongs to sine and on_off, the light is static"),
    (
        ["--light", "candle", "--frequency", "2"],
        "--frequency belongs to sine and on_off, the light is candle",
    ),
    (["--light", "candle", "--depth", "0.5"], "--depth belongs to sine and on_off, the light is candle"),
    (["--light", "sine", "--depth", "2"], "depth must be in [0, 1], got 2"),
    (["--light", "on_off", "--depth", "-0.1"], "depth must be in [0, 1], got -0.1"),
    (["--light", "sine", "--frequency", "-1"], "frequency must be at least 0, got -1"),
    (["--fps", "0"], "fps must be above 0, got 0"),
    (["--fps", "-60"], "fps must be above 0, got -60"),
    (["--light", "lamp.csv", "--fps", "nan"], "fps must be above 0, got nan"),
]
BURLEY = [*CIRCLE, "--profile", "burley"]
BAD_SIZES = [
    ([*CIRCLE, "--frames", "0"], "frames must be at least 1, got 0"),
    ([*CIRCLE, "--frames", "-3"], "frames must be at least 1, got -3"),
    ([*CIRCLE, "--frames", "50"], "frames must be more than 50 for figures from frame 51 on, got 50"),
    ([*LINE, "--frames", "0"], "frames must be at least 1, got 0"),
    ([*CIRCLE, "--seeds", "0"], "seeds must be at least 1, got 0"),
    ([*LINE, "--seeds", "-1"], "seeds must be at least 1, got -1"),
    ([*BATCH, "--seeds", "0"], "seeds must be at least 2, got 0"),
    ([*BURLEY, "--d", "-1"], "d must be a positive length in mm, got -1"),
    ([*BURLEY, "--radius", "-1"], "radius must be a positive length in mm, got -1"),
    ([*BURLEY, "--distance", "-1"], "distance must be at least 0 and finite, in mm, got -1"),
    ([*LINE, "--d", "-1"], "d must be a positive length in mm, got -1"),
    ([*LINE, "--d", "0"], "d must be a positive length in mm, got 0"),
    ([*LINE, "--length", "-1"], "length must be a positive length in mm, got -1"),
    ([*LINE, "--length", "nan"], "length must be a positive length in mm, got nan"),
    ([*LINE, "--texels", "0"], "texels must be at least 1, got 0"),
    ([*LINE, "--texels", "-4"], "texels must be at least 1, got -4"),
    ([*LINE, "--amplitude", "-1"], "irradiance must be finite and at least 0 everywhere"),
    ([*LINE, "--profile", "lamp"], "--profile must be one of step, ramp, pulse, or a CSV file, got 'lamp'"),
    ([*LINE, "--profile", "missing.csv"], "missing.csv: there is no such file; check the path"),
    ([*LINE, "--profile", "profile.csv"], "profile.csv, row 3: column 'irradiance' has 'nan'"),
    ([*LINE, "--profile", "lamp.csv"], "lamp.csv, row 1: there is no column 'x'"),
]


@pytest.mark.parametrize("command, message", BAD_CONSTANTS, ids=words)
def test_constants_out_of_their_domain(command, message, earlier, capsys):
    assert refused(command, earlier, capsys).startswith(message)


@pytest.mark.parametrize("scenario", [CIRCLE, LINE], ids=["circle", "line"])
@pytest.mark.parametrize("arguments, message", BAD_LIGHT, ids=words)
def test_light_that_is_none(scenario, arguments, message, earlier, capsys):
    assert refused([*scenario, *arguments], earlier, capsys).startswith(message)


@pytest.mark.parametrize("command, message", BAD_SIZES, ids=words)
def test_sizes_and_profiles_out_of_their_domain(command, message, earlier, capsys):
    assert refused(command, earlier, capsys).startswith(message)


@pytest.mark.parametrize("seed", [-1, 2**32, 2**70])
@pytest.mark.parametrize("command", [CIRCLE, LINE, BATCH], ids=["circle", "line", "batch-mean"])
def test_a_seed_that_is_no_key(command, seed, earlier, capsys):
    message = refused([*command, "--seed", str(seed)], earlier, capsys)
    assert message == f"seed must be in [0, 2^32), got {seed}"


@pytest.mark.parametrize(
    "arguments",
    [
        ["circle", "--profile", "lamp"],
        ["circle", "--controller", "x"],
        ["line", "--kernel", "x"],
        ["circle", "--frames", "1.5"],
    ],
)
def test_what_the_parser_refuses(arguments, earlier, capsys):
    before = contents(earlier)
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", *arguments, "--out", "out"])
    printed = capsys.readouterr()
    assert stopped.value.code == 2 and printed.out == "" and contents(earlier) == before
    assert printed.err.splitlines()[-1].startswith(
        f"sssfit simulate {arguments[0]}: error: argument {arguments[1]}:"
    )


@pytest.mark.parametrize(
    "command", [["simulate", "circle"], ["simulate", "line"], ["simulate", "batch-mean"]]
)
def test_an_empty_output_name(command, earlier, capsys):
    before = contents(earlier.parent)
    assert main([*command, "--out", ""]) == 2
    assert capsys.readouterr().err == "sssfit: --out must name a directory; use . for the current one\n"
    assert contents(earlier.parent) == before


def test_output_that_is_a_file(earlier, capsys):
    before = contents(earlier.parent)
    assert main([*CIRCLE, "--controller", "fixed", "--out", "out/notes.txt"]) == 2
    printed = capsys.readouterr()
    message = "is a file, not a directory; move it away or choose another directory"
    assert printed.err == f"sssfit: out/notes.txt: {message}\n" and printed.out == ""
    assert contents(earlier.parent) == before


def test_a_disk_that_fills_up(earlier, monkeypatch, capsys):
    put = Output.put

    def filling_up(output, path, content):
        if path.endswith(".csv"):
            raise OSError(28, "No space left on device")
        put(output, path, content)

    monkeypatch.setattr(Output, "put", filling_up)
    message = refused([*CIRCLE, "--controller", "fixed"], earlier, capsys)
    assert message == "out: the disk is full, earlier outputs are untouched; free space and run again"


@pytest.mark.parametrize("owner, name", [(measure, "summarize"), (plot, "circle")])
def test_interrupting_leaves_earlier_outputs(owner, name, earlier, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    before = contents(earlier)
    monkeypatch.setattr(owner, name, interrupted)
    assert main([*CIRCLE, "--controller", "fixed", "--out", "out"]) == 2
    assert capsys.readouterr().err == INTERRUPTED and contents(earlier) == before


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are sent the POSIX way")
@pytest.mark.parametrize("delay", [0.3, 1.0, 2.5, 5.0])
@pytest.mark.parametrize(
    "command",
    [["circle", "--seeds", "200000"], ["line", "--seeds", "2000"], ["batch-mean", "--seeds", "100000"]],
)
def test_a_real_interrupt_of_a_real_process(command, delay, tmp_path):
    """At any moment: in the imports, in compiling, and in compiled code."""
    out = tmp_path / "out"
    arguments = [sys.executable, "-m", "sssfit.cli", "simulate", *command, "--out", str(out)]
    process = subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True)
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=120)
    assert (process.returncode, error) == (2, INTERRUPTED)
    assert not out.exists()
