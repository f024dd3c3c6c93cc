"""Where texels lie, and in which turns warps come to read them."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sssfit.frames import mipmap
from sssfit.trade import warps
from sssfit.trade.texture import Texture
from sssfit.trade.warps import Schedule

RNG = np.random.default_rng(0)


# --- textures


@pytest.mark.parametrize("size, tile", [((1, 1), (1, 1)), ((5, 3), (4, 4)), ((17, 30), (4, 8))])
def test_every_texel_has_a_place_of_its_own(size, tile):
    texture = Texture(*size, texel_bytes=4, tile=tile)
    assert texture.sizes == jax.eval_shape(mipmap.build, np.ones((*size, 1)), np.ones(size)).sizes
    every = [(k, *place) for k, one in enumerate(texture.sizes) for place in np.ndindex(*one)]
    found = np.asarray(texture.address(*np.array(every).T))
    assert len(np.unique(found)) == len(every) and (found % 4 == 0).all()
    level = np.searchsorted(texture.starts, found, side="right") - 1
    assert (level == [k for k, *_ in every]).all() and found.max() + 4 <= texture.size_bytes


def test_a_tile_is_a_line_and_rows_are_rows():
    row, column = np.mgrid[:8, :12]
    tiled = np.asarray(Texture(8, 12).address(0, row, column)) // 128
    assert (tiled == row // 4 * 3 + column // 4).all()
    in_rows = np.asarray(Texture(8, 12, tile=(1, 1)).address(0, row, column))
    assert (in_rows == (row * 12 + column) * 8).all()


def test_beyond_a_level_the_edge_is_read():
    texture = Texture(6, 9)
    assert int(texture.address(1, 99, -5)) == int(texture.address(1, 2, 0))


@pytest.mark.parametrize(
    "options, message",
    [
        ((0, 4), "height must be a whole number of at least 1, got 0"),
        ((4, 4, 8, (0, 4)), "tile's rows must be a whole number"),
        ((4, 4, 2.0), "texel_bytes must be a whole number"),
        ((2**14, 2**14), r"a texture must be smaller than 2\^31 bytes"),
    ],
)
def test_textures_that_cannot_be_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Texture(*options)


# --- warps


@pytest.mark.parametrize("order", ["morton", "rows"])
def test_every_pixel_has_one_thread(order):
    found = warps.tiles(10, 19, Schedule(order=order))
    assert found.shape == (9, 32)
    assert sorted(found[found >= 0].tolist()) == list(range(190))


def test_tiles_follow_the_curve():
    first = warps.tiles(8, 8, Schedule(warp=(2, 2)))[:, 0]
    assert [(p // 16, p % 8 // 2) for p in first[:8]] == [(r, c) for r, c in zip(
        (0, 0, 1, 1, 0, 0, 1, 1), (0, 1, 0, 1, 2, 3, 2, 3), strict=True
    )]  # fmt: skip
    in_rows = warps.tiles(8, 8, Schedule(warp=(2, 2), order="rows"))[:, 0]
    assert in_rows[:5].tolist() == [0, 2, 4, 6, 16]


def turns_one_by_one(lengths, schedule):
    """The module's model as a loop over turns, with a queue for each slot."""
    queues = {}
    for number, warp in enumerate(np.flatnonzero(lengths)):
        block, within = divmod(number, schedule.block)
        turn, unit = divmod(block, schedule.units)
        slot = (turn * schedule.block + within) % schedule.resident
        queues.setdefault((slot, unit), []).extend((int(warp), step) for step in range(lengths[warp]))
    for turn in range(max(map(len, queues.values()), default=0)):
        for slot, unit in sorted(queues):
            if turn < len(queues[slot, unit]):
                yield (*queues[slot, unit][turn], unit)


@given(st.lists(st.integers(0, 5), max_size=40), st.integers(1, 4), st.integers(1, 3), st.integers(1, 3))
def test_turns_are_those_of_a_plain_loop(lengths, units, resident, block):
    schedule = Schedule(units=units, resident=resident, block=block, warp=(1, 1))
    found = [
        request
        for piece in warps.turns(np.array(lengths, int), schedule)
        for request in zip(piece.warp.tolist(), piece.step.tolist(), piece.unit.tolist(), strict=True)
        if request[0] >= 0
    ]
    assert found == list(turns_one_by_one(np.array(lengths, int), schedule))


def test_turns_come_in_pieces(monkeypatch):
    lengths, schedule = RNG.integers(0, 9, 300), Schedule(units=3, resident=2)

    def requests():
        pieces = list(warps.turns(lengths, schedule))
        every = np.concatenate([np.stack([p.warp, p.step, p.unit]) for p in pieces], axis=1)
        return len(pieces), every[:, every[0] >= 0]

    _, whole = requests()
    monkeypatch.setattr(warps, "_WINDOW", 3 * 32 * 6)
    pieces, found = requests()
    assert pieces > 10 and (found == whole).all()


@given(st.lists(st.lists(st.integers(-1, 300), min_size=4, max_size=4), max_size=12))
@settings(max_examples=30)
def test_a_request_reads_each_line_once(asked):
    asked = np.array(asked, np.int32).reshape(-1, 4)
    found = warps.merged(asked, np.arange(len(asked)), Schedule(line_bytes=32))
    wanted = [
        (line * 32, unit)
        for unit, row in enumerate(asked)
        for line in sorted({a // 32 for a in row if a >= 0})
    ]
    assert list(zip(found.addresses.tolist(), found.units.tolist(), strict=True)) == wanted


@pytest.mark.parametrize(
    "options, message",
    [
        ({"units": 0}, "units must be a whole number of at least 1, got 0"),
        ({"block": 1.5}, "block must be a whole number"),
        ({"warp": (4, 0)}, "warp's columns must be"),
        ({"order": "hilbert"}, "order must be one of morton, rows, got 'hilbert'"),
    ],
)
def test_schedules_that_cannot_be_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Schedule(**options)
