"""Names and numbers of a sequence's files, what is kept of an unfinished one, and figures by hand."""

import io
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from sssfit.estimators import policies
from sssfit.files.errors import FileError
from sssfit.frames import preview, procedural, sequence, sequence_files, sequence_ledger, sequence_output
from sssfit.frames.sequence_ledger import UNFINISHED, Ledger
from sssfit.frames.sequence_output import Row


@pytest.fixture(scope="module")
def frame():
    return procedural.frame(1, width=64, height=36)


def names(folder, *found):
    for name in found:
        (folder / name).write_bytes(b"")
    return str(folder / "*.exr")


def test_frames_are_sorted_by_number_not_by_name(tmp_path):
    found = sequence_files.numbered([names(tmp_path, "b_9.exr", "b_10.exr", "a_011.exr")])
    assert [(f.number, f.digits, f.path.name) for f in found] == [
        (9, "9", "b_9.exr"),
        (10, "10", "b_10.exr"),
        (11, "011", "a_011.exr"),
    ]


def test_a_file_that_is_called_like_a_pattern(tmp_path):
    names(tmp_path, "f[1]_1.exr", "f1_2.exr")
    assert [p.name for p in sequence_files.expanded([str(tmp_path / "f[1]_1.exr")])] == ["f[1]_1.exr"]
    assert [p.name for p in sequence_files.expanded([str(tmp_path / "f[1]_2.exr")])] == ["f1_2.exr"]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ([], r"\*\.exr: no file has such a name; check the folder and the pattern"),
        (["a.exr"], r"a\.exr: the name has no number at its end; number the frames as in frame_0001\.exr"),
        (
            ["a_1.exr", "b_01.exr"],
            r"b_01\.exr: has the number 01 as .*a_1\.exr has; give one file for each number",
        ),
        (
            ["a_08.exr", "a_11.exr"],
            r"a_08\.exr: after this frame, number 09 is missing; the next one is 11; bring 09 back, or give",
        ),
    ],
)
def test_names_that_are_refused(tmp_path, files, message):
    with pytest.raises(FileError, match=message):
        sequence_files.numbered([names(tmp_path, *files)])


def test_references_belong_to_numbers_and_may_have_gaps():
    frames = sequence_files.numbered([f"frame_{k:03d}.exr" for k in range(5)])
    found = sequence_files.references(["r_0.exr", "r_03.exr", "r_77.exr"], frames)
    assert {number: path.name for number, path in found.items()} == {0: "r_0.exr", 3: "r_03.exr"}
    assert sequence_files.references([], frames) == {}
    message = r"r_77\.exr: neither this reference nor another has the number of a frame, 000 to 004; number"
    with pytest.raises(FileError, match=message):
        sequence_files.references(["r_77.exr", "r_78.exr"], frames)


def test_frames_that_do_not_belong_into_a_sequence(frame):
    sequence_files.check(frame, "f_1.exr", (64, 36))
    message = r"f_1\.exr: has 64 x 36 pixels, the frames before it 32 x 18; render all frames in one size"
    with pytest.raises(FileError, match=message):
        sequence_files.check(frame, "f_1.exr", (32, 18))
    wrong = frame._replace(motion=frame.motion.at[20, 26, 1].set(-40.0))
    message = (
        r"f_1\.exr, column 26, row 20: motion\.Y is -40, more than the frame of 64 x 36 pixels holds; write "
        r"motion in pixels, where a point was in the frame before minus where it is, y down"
    )
    with pytest.raises(FileError, match=message):
        sequence_files.check(wrong, "f_1.exr", (64, 36))
    sequence_files.check(wrong, "f_0.exr", None)
    # Nobody looks where nothing is.
    assert int(frame.profile_id[0, 0]) == 0
    sequence_files.check(frame._replace(motion=frame.motion.at[0, 0].set(1e6)), "f_1.exr", (64, 36))


@pytest.mark.parametrize("mode", ["fixed", "as", "ocv", "in_frame"])
@pytest.mark.parametrize("dtype", ["float32", "float16"])
def test_a_state_comes_back_as_it_was(frame, tmp_path, mode, dtype):
    config = sequence.Config(policies.named(mode), {1: (1.0, 0.5, 0.3), 2: None}, history_dtype=dtype)
    like = sequence.init(frame, config)
    state = jax.tree.map(lambda leaf: leaf if isinstance(leaf, int) else leaf + leaf.dtype.type(0.1), like)
    state = state._replace(number=7)
    row = Row(6, 8.25, math.inf, 8, 1.0, 0.0, 0.1, 2, 16)
    ledger = Ledger({"options": {"mode": mode}}, rows=[row], size=(64, 36), ids=[1, 2], white=0.1)
    ledger.seconds.append((0.1, 0.2, 0.3))
    sequence_ledger.save(tmp_path, ledger, state)
    kept = sequence_ledger.load(tmp_path)
    assert kept is not None
    found, leaves = kept
    assert found == ledger and isinstance(found.rows[0], Row)
    again = sequence_ledger.restored(leaves, like, tmp_path)
    assert jax.tree.structure(again) == jax.tree.structure(state) and again.number == 7
    for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(state), strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other), strict=True)


def test_a_state_that_does_not_fit(frame, tmp_path):
    profiles = {1: (1.0, 0.5, 0.3), 2: None}
    kept = sequence.init(frame, sequence.Config(policies.named("as"), profiles))
    sequence_ledger.save(tmp_path, Ledger({}, size=(64, 36)), kept)
    other = sequence.init(frame, sequence.Config(policies.named("ocv"), profiles))
    found = sequence_ledger.load(tmp_path)
    assert found is not None
    with pytest.raises(FileError, match="has another state than these frames and options make"):
        sequence_ledger.restored(found[1], other, tmp_path)
    (tmp_path / UNFINISHED).write_bytes((tmp_path / UNFINISHED).read_bytes()[:500])
    with pytest.raises(FileError, match=r"of an unfinished sequence cannot be read \(.*; remove the file"):
        sequence_ledger.load(tmp_path)


def test_only_leftovers_are_cleared(tmp_path):
    kept = ["notes.tmp", UNFINISHED, ".sssfit-staging", "scattered_01.exr"]
    names(tmp_path, *kept, ".sssfit-0123456789abcdef.tmp")
    (tmp_path / ".sssfit-staging-x").mkdir()
    (tmp_path / ".sssfit-staging-x" / "summary.json").write_bytes(b"")
    sequence_ledger.clear(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(kept)


def test_the_state_of_large_frames_is_written_seldom():
    due = [n for n in range(1, 25) if sequence_ledger.is_due(n, sequence_ledger.LARGE_PIXELS + 1)]
    assert due == [8, 16, 24]


def test_figures_by_hand():
    counts = np.array([[8, 8, 64], [20, 0, 0]])
    mask = np.array([[True, True, True], [True, False, False]])
    found = sequence_output.row(5, counts, counts == 20, mask, (8, 64), 30.0)
    assert found == Row(5, 25.0, 30.0, 64, 0.5, 0.25, 0.25, 4, 100)
    none = sequence_output.row(6, counts, counts == 20, np.zeros((2, 3), bool), (8, 64))
    assert none == Row(6, None, None, None, None, None, None, 0, 0)
    black = found._replace(frame=7, psnr=math.inf, mean_count=35.0)
    assert sequence_output.table([found, none, black]).decode().splitlines() == [
        "frame,mean_count,psnr,largest_count,share_at_min,share_at_max,share_new,pixels,samples",
        "5,25.0,30.0,64,0.5,0.25,0.25,4,100",
        "6,,,,,,,0,0",
        "7,35.0,inf,64,0.5,0.25,0.25,4,100",
    ]
    summary = sequence_output.summary([found, none, black])
    assert (summary["mean_count"], summary["psnr"], summary["psnr_frames"]) == (30.0, 30.0, 1)
    assert (summary["frames"], summary["first_frame"], summary["last_frame"]) == (3, 5, 7)


def test_counts_in_colours():
    counts = np.array([[0, 1, 32, 64]])
    made = sequence_output.files(np.ones((1, 4, 3)), counts, "3", white=2.0, most=64)
    with Image.open(io.BytesIO(made["count_3.png"])) as picture:
        grey, *colours = np.asarray(picture)[0].astype(int)
    assert grey.tolist() == [85, 85, 85]
    # Viridis ends in yellow and gets brighter all the way.
    brightness = [colour.sum() for colour in colours]
    assert brightness == sorted(brightness) and colours[-1].tolist() == [253, 231, 37]


def test_the_preview_is_made_smaller_and_plays_all_frames(tmp_path):
    wide = np.zeros((10, sequence_output.PREVIEW_WIDTH + 20, 3))
    for k in range(3):
        wide[:, 200 * k : 200 * k + 200] = 1
        (tmp_path / f"{k}.png").write_bytes(preview.png(wide, white=1.0))
    pictures = [tmp_path / f"{k}.png" for k in range(3)]
    made = sequence_output.moving_preview(pictures)
    with Image.open(io.BytesIO(made)) as film:
        assert film.size == (330, 5) and getattr(film, "n_frames", 1) == 3
    assert made == sequence_output.moving_preview(pictures)


def test_a_difference_is_found_at_any_depth():
    one = {"b": {"x": 1, "y": [2]}, "c": 0}
    assert sequence_ledger.difference(one, {"b": {"x": 1, "y": [2]}, "c": 0}) is None
    assert sequence_ledger.difference(one, {"b": {"x": 1, "y": [3]}, "c": 0}) == "y"
    assert sequence_ledger.difference(one, {"b": {"x": 1, "y": [2]}}) == "c"


def test_white_leaves_room():
    assert sequence_output.white(jnp.zeros((4, 4, 3))) is None
    assert sequence_output.white(jnp.full((4, 4, 3), 1.5)) == 3.0
