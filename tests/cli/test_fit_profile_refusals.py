"""`sssfit fit profile`: bad input is one sentence and exit code 2, and nothing that was there is lost."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from sssfit.cli.main import main
from sssfit.files.exr import encode_exr
from sssfit.files.output import Output
from sssfit.fitting import measured

# The shape that test_fit_profile.py compiles, too.
R = np.geomspace(0.2, 12, 16)
# Burley's, of an albedo of 0.7 and a d of 1.5 mm.
PROFILE = 0.7 * (np.exp(-R / 1.5) + np.exp(-R / 4.5)) / (8 * np.pi * 1.5 * R)
INTERRUPTED = "sssfit: interrupted; outputs are either as before or complete, run again to finish\n"
CSV = {
    "wax.csv": "r_mm,R\n" + "".join(f"{r},{0.1 / r}\n" for r in R),
    "noise.csv": "r_mm,R,sigma\n" + "".join(f"{r},{x},{0.02 * x}\n" for r, x in zip(R, PROFILE, strict=True)),
    "edge.csv": "r_mm,R\n-2,0.1\n-1,0.2\n1,0.5\n2,0.6\n",
    "unit.csv": "r,R\n1,1\n",
    "cm.csv": "r_cm,R\n1,1\n",
    "none.csv": "r_mm,value\n1,1\n",
    "unknown.csv": "r_mm,R,notes\n1,1,1\n",
    "unsorted.csv": "r_mm,R\n2,1\n1,1\n",
    "repeated.csv": "r_mm,R\n1,1\n1,1\n",
    "signed.csv": "r_mm,R\n-1,1\n1,1\n",
    "sigma.csv": "r_mm,R,sigma\n1,1,0.1\n2,1,0\n",
    "negative.csv": "r_mm,R\n1,1\n2,-1\n",
    "zero.csv": "r_mm,R\n1,0\n2,0\n",
    "text.csv": "r_mm,R\n1,x\n",
    "short.csv": "r_mm,R\n1,1\n2,0.5\n",
    "empty.csv": "",
    "header.csv": "r_mm,R\n",
    "no.exr": "r_mm,R\n1,1\n",
}
PIXELS = {
    "grey.exr": {"Y": np.ones((32, 32), np.float32)},
    "dark.exr": {"Y": np.zeros((32, 32), np.float32)},
    "tiny.exr": {"Y": np.ones((4, 4), np.float32)},
    "two.exr": {f"{n}.{c}": np.ones((32, 32), np.float32) for n in ("sss", "diff") for c in "RGB"},
    "right.exr": {"Y": np.linspace(0, 1, 32, dtype=np.float32) * np.ones((32, 1), np.float32)},
}


def contents(directory):
    return {
        str(p.relative_to(directory)): p.read_bytes() if p.is_file() else None for p in directory.rglob("*")
    }


@pytest.fixture
def earlier(tmp_path, monkeypatch):
    """A working directory with input files and with an output directory of an earlier run."""
    monkeypatch.chdir(tmp_path)
    for name, text in CSV.items():
        (tmp_path / name).write_text(text)
    for name, channels in PIXELS.items():
        (tmp_path / name).write_bytes(encode_exr(channels, {}))
    out = tmp_path / "out"
    out.mkdir()
    for name in ("manifest.json", "fit.json", "notes.txt"):
        (out / name).write_text("earlier")
    return out


def refused(arguments, out, capsys, where="out"):
    """The one line that is printed."""
    before = contents(out.parent)
    assert main(["fit", "profile", *arguments, "--out", where]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith("sssfit: ") and printed.err.count("\n") == 1
    assert contents(out.parent) == before
    return printed.err[len("sssfit: ") : -1]


IMAGE = ["grey.exr", "--pixel-mm", "1"]
BAD_FILES = [
    (["missing.csv"], "missing.csv: there is no such file; check the path"),
    (["unit.csv"], "unit.csv, row 1: column 'r' is a distance without a unit; name it 'r_mm'"),
    (["cm.csv"], "cm.csv, row 1: column 'r_cm' is a distance in another unit than mm; name it 'r_mm'"),
    (["none.csv"], "none.csv, row 1: there is no column 'R'; the columns are r_mm, R or R_r, R_g, R_b"),
    (["unknown.csv"], "unknown.csv, row 1: column 'notes' is not known beside 'R'"),
    (["unsorted.csv"], "unsorted.csv, row 3: r_mm 1 follows 2; sort the rows by their distance"),
    (["repeated.csv"], "repeated.csv, row 3: r_mm 1 stands there twice; keep one row for each distance"),
    (["signed.csv"], "signed.csv, row 2: r_mm is -1; a distance from a point is at least 0"),
    (
        ["signed.csv", "--response", "beam", "--beam-radius", "1"],
        "signed.csv, row 2: r_mm is -1; a distance from a beam's centre is at least 0",
    ),
    (["sigma.csv"], "sigma.csv, row 3: sigma is 0; write a standard deviation above 0, or leave"),
    (["negative.csv"], "negative.csv, row 3: R is -1, below 0; give its sigma if that is noise"),
    (["zero.csv"], "zero.csv, column 'R': no value is above 0; write what was measured there"),
    (["text.csv"], "text.csv, row 2: column 'R' has 'x' where a number belongs; write a number"),
    (["empty.csv"], "empty.csv: the file is empty; write a header line"),
    (["header.csv"], "header.csv: there is a header but no data row"),
    (["edge.csv", "--response", "edge"], "edge.csv, column 'r_mm': R is larger at distances above 0"),
    (["short.csv"], "values must hold at least 3 points for the 2 parameters of burley and the noise, got 2"),
    (["no.exr", "--pixel-mm", "1"], "no.exr: is not an EXR image"),
    (["missing.exr", "--pixel-mm", "1"], "missing.exr: there is no such file; check the path"),
    (["dark.exr", "--pixel-mm", "1"], "dark.exr: a channel is nowhere above 0; give an image of the light"),
    (["tiny.exr", "--pixel-mm", "1"], "tiny.exr: too few pixels are left to see a profile in"),
    (["two.exr", "--pixel-mm", "1"], "two.exr: it is not clear which layer is meant; name one of its layers"),
    ([*IMAGE, "--layer", "sss"], "grey.exr: there is no layer 'sss'; name one of its layers by layer"),
    (
        ["right.exr", "--pixel-mm", "1", "--response", "edge"],
        "right.exr: the brighter side of the edge lies above 0; turn it by flip (--flip), or check axis",
    ),
]
BAD_OPTIONS = [
    (["wax.csv", "--model", "bssrdf"], "model must be one of burley, gaussians:K, dipole, jimenez with K"),
    (["wax.csv", "--model", "burley", "gaussians:9"], "model must be one of burley, gaussians:K"),
    (["wax.csv", "--response", "beam"], "beam_radius must be a length in mm above 0 for a beam, got None"),
    (["wax.csv", "--beam-radius", "1"], "beam_radius belongs to the response 'beam', not to 'radial'"),
    (["wax.csv", "--eta", "1.4"], "--eta belongs to --model dipole"),
    (["wax.csv", "--model", "dipole", "--eta", "9"], "eta must be from 0.3 to 3.5, got 9"),
    (["wax.csv", "--model", "dipole", "--cutoff", "16"], "--cutoff belongs to --model burley"),
    (["wax.csv", "--cutoff", "-1"], "cutoff must be above 0, got -1"),
    (["wax.csv", "--weights", "sigma"], "weights 'sigma' need the standard deviations of the values"),
    (["wax.csv", "--shared", "dmfp"], "shared must be among albedo, d, got 'dmfp'"),
    (["wax.csv", "--pixel-mm", "1"], "--pixel-mm belongs to an EXR image"),
    (["wax.csv", "--layer", "sss"], "--layer belongs to an EXR image"),
    (["wax.csv", "--flip"], "--flip belongs to an EXR image"),
    (["grey.exr"], "--pixel-mm must say how many mm wide a pixel of the image is"),
    (["grey.exr", "--pixel-mm", "0"], "pixel_mm must be above 0, got 0"),
    ([*IMAGE, "--irradiance", "-1"], "irradiance must be above 0, got -1"),
    ([*IMAGE, "--axis", "y"], "--axis belongs to --response line and edge"),
    ([*IMAGE, "--center", "1", "nan"], "center must be two finite numbers of pixels, got [1.0, nan]"),
    (["wax.csv", "--steps", "100"], "--steps belongs to --posterior"),
    (["wax.csv", "--seed", "0"], "--seed belongs to --posterior"),
    (["wax.csv", "--resume"], "--resume belongs to --posterior"),
]


@pytest.mark.parametrize("arguments, message", BAD_FILES, ids=lambda value: " ".join(value)[:40])
def test_files_that_are_no_measurement(arguments, message, earlier, capsys):
    assert refused(arguments, earlier, capsys).startswith(message)


@pytest.mark.parametrize("arguments, message", BAD_OPTIONS, ids=lambda value: " ".join(value)[:40])
def test_options_out_of_their_domain(arguments, message, earlier, capsys):
    assert refused(arguments, earlier, capsys).startswith(message)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--walkers", "2"], "walkers must be"),
        (["--steps", "0"], "steps must be"),
        (["--seed", "-1"], "seed must be"),
        (["--weights", "area"], "weights must be left out where sigma is given"),
    ],
)
def test_chains_that_cannot_be(arguments, message, earlier, capsys):
    pytest.importorskip("emcee")
    assert refused(["noise.csv", "--posterior", *arguments], earlier, capsys).startswith(message)


@pytest.mark.parametrize(
    "arguments",
    [["--response", "disc"], ["--loss", "l1"], ["--solver", "bfgs"], ["--axis", "z"], ["--beam-radius", "x"]],
)
def test_what_the_parser_refuses(arguments, earlier, capsys):
    before = contents(earlier.parent)
    with pytest.raises(SystemExit) as stopped:
        main(["fit", "profile", "wax.csv", *arguments, "--out", "out"])
    printed = capsys.readouterr()
    assert stopped.value.code == 2 and printed.out == "" and contents(earlier.parent) == before
    assert printed.err.splitlines()[-1].startswith(f"sssfit fit profile: error: argument {arguments[0]}:")


def test_outputs_that_are_none(earlier, capsys):
    assert refused(["wax.csv"], earlier, capsys, where="") == (
        "--out must name a directory; use . for the current one"
    )
    message = "is a file, not a directory; move it away or choose another directory"
    assert refused(["wax.csv"], earlier, capsys, where="out/notes.txt") == f"out/notes.txt: {message}"


def test_a_directory_is_not_left_behind(earlier, capsys):
    refused(["short.csv"], earlier, capsys, where="new/deep")


def test_a_disk_that_fills_up(earlier, monkeypatch, capsys):
    put = Output.put

    def filling_up(output, path, content):
        if path == "table.csv":
            raise OSError(28, "No space left on device")
        put(output, path, content)

    monkeypatch.setattr(Output, "put", filling_up)
    message = refused(["noise.csv"], earlier, capsys)
    assert message == "out: the disk is full, earlier outputs are untouched; free space and run again"


def test_interrupting_leaves_earlier_outputs(earlier, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    before = contents(earlier)
    monkeypatch.setattr(measured, "fit", interrupted)
    assert main(["fit", "profile", "noise.csv", "--out", "out"]) == 2
    assert capsys.readouterr().err == INTERRUPTED and contents(earlier) == before


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are sent the POSIX way")
def test_a_killed_chain_goes_on(earlier):
    """Killed without a chance to clean up, as by a machine that goes down."""
    pytest.importorskip("emcee")
    data = ["noise.csv", "--posterior", "--walkers", "8", "--steps", "200000", "--quiet"]
    arguments = [sys.executable, "-m", "sssfit.cli", "fit", "profile", *data, "--out", "chain"]
    process = subprocess.Popen(arguments, stderr=subprocess.PIPE)
    chain = earlier.parent / "chain" / "chain.h5"
    waiting = time.monotonic()
    # Until the chain was written a second time, with steps in it.
    while (not chain.exists() or chain.stat().st_size < 100_000) and time.monotonic() - waiting < 300:
        assert process.poll() is None
        time.sleep(0.2)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not (earlier.parent / "chain" / "fit.json").exists() and chain.stat().st_size >= 100_000
    from emcee.backends import HDFBackend

    drawn = HDFBackend(str(chain), read_only=True).get_log_prob()
    assert drawn is not None
    steps = max(3000, len(drawn) + 1)
    again = [*data[:-2], str(steps), "--quiet", "--resume", "--out", "chain"]
    assert main(["fit", "profile", *again]) == 0
    files = {path.name for path in (earlier.parent / "chain").iterdir()}
    assert "corner.png" in files and not any(name.startswith(".sssfit-") for name in files)
