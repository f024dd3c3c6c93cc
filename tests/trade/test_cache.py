"""The caches against a plain replay with ordered dictionaries, and where the answer is known without one."""

from collections import OrderedDict

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sssfit.trade import _replacement, cache
from sssfit.trade.cache import Accesses, Counts, Level


def replayed_plainly(addresses, units, levels):
    """One access after the other, each set an ordered dictionary; the package replays all sets at once."""
    held = [{} for _ in levels]
    counts = [[0, 0] for _ in levels]
    for address, unit in zip(addresses, units, strict=True):
        for k, level in enumerate(levels):
            line, number = address // level.line_bytes, level.size_bytes // level.line_bytes // level.ways
            cache_of = unit * level.units // levels[0].units
            lines = held[k].setdefault((cache_of, line % number), OrderedDict())
            counts[k][0] += 1
            if line in lines:
                lines.move_to_end(line)
                break
            counts[k][1] += 1
            lines[line] = None
            if len(lines) > level.ways:
                lines.popitem(last=False)
    return tuple(
        Counts(reads, reads - misses, misses, misses * level.line_bytes)
        for (reads, misses), level in zip(counts, levels, strict=True)
    )


@st.composite
def hierarchies(draw):
    """One to three levels that may follow each other; few shapes, for each is compiled."""
    levels = []
    for line, units in zip((16, 32, 64), (4, 2, 1), strict=True):
        ways, sets = draw(st.sampled_from([(1, 4), (3, 1), (8, 3)]))
        levels.append(Level(line * ways * sets, line, ways, units))
    return levels[: draw(st.integers(1, 3))]


@settings(max_examples=12)
@given(hierarchies(), st.integers(0, 600), st.integers(1, 60), st.integers(0, 2**32))
def test_counts_are_those_of_a_plain_replay(levels, number, lines, seed):
    rng = np.random.default_rng(seed)
    addresses = rng.integers(0, 16 * lines, number)
    units = rng.integers(0, levels[0].units, number)
    assert cache.simulate(addresses, units, levels) == replayed_plainly(
        addresses.tolist(), units.tolist(), levels
    )


def test_a_real_gpu_is_replayed_exactly():
    levels = cache.PRESETS["titan_x_pascal"]
    rng = np.random.default_rng(1)
    # Near each other, so that there are hits; far enough apart for lines to be replaced.
    addresses = (np.cumsum(rng.integers(-900, 1000, 40_000)) % 2**20).astype(int)
    units = rng.integers(0, 2, 40_000)
    found = cache.simulate(addresses, units, levels)
    assert found == replayed_plainly(addresses.tolist(), units.tolist(), levels)
    assert 0.2 < found[0].miss_rate < 0.9 and found[0].misses > found[1].misses > 0


def test_a_busy_set_is_replayed_piece_by_piece():
    # One set with more reads than a piece has rows, beside sets with few; every line's neighbour too.
    rng = np.random.default_rng(2)
    busy = rng.integers(0, 12, 3000) * 4
    addresses = np.concatenate([busy, np.arange(1, 40)])[rng.permutation(3039)] * 64
    levels = [Level(4 * 8 * 64, 64, 8)]
    assert cache.simulate(addresses, 0, levels) == replayed_plainly(addresses, [0] * 3039, levels)


def test_more_sets_than_a_word_of_16_bits_counts():
    levels = [Level(2 * 70_000 * 16, 16, 2)]
    rng = np.random.default_rng(3)
    # Sets 2^16 apart have the same lower digits.
    addresses = (rng.integers(0, 3, 2000) * 70_000 + rng.choice([5, 5 + 2**16], 2000)) * 16
    assert cache.simulate(addresses, 0, levels) == replayed_plainly(addresses, [0] * 2000, levels)


@pytest.mark.parametrize("ways", [1, 4, 64])
def test_a_stream_misses_once_for_each_line(ways):
    level = Level(4096, 64, ways)
    found = cache.simulate(np.arange(0, 64 * 1000, 8), 0, [level])
    assert found == (Counts(8000, 7000, 1000, 64_000),)


def test_a_sweep_that_is_too_large_always_misses():
    level = Level(64 * 16, 64, 16)
    sweep = np.tile(np.arange(17) * 64, 10)
    assert cache.simulate(sweep, 0, [level])[0].misses == 170
    # By one line smaller it stays.
    assert cache.simulate(np.tile(np.arange(16) * 64, 10), 0, [level])[0].misses == 16


def test_two_lines_of_one_set_replace_each_other_where_they_are_directly_mapped():
    in_turn = np.tile([0, 4096], 50)
    assert cache.simulate(in_turn, 0, [Level(4096, 64, 1)])[0].misses == 100
    assert cache.simulate(in_turn, 0, [Level(4096, 64, 2)])[0].misses == 2


def test_the_least_recently_used_line_goes():
    a, b, c = 0, 64, 128
    level = Level(128, 64, 2)
    # Reading a again makes b the older one, whichever came first.
    assert cache.simulate([a, b, a, c, a], 0, [level])[0].misses == 3
    assert cache.simulate([a, b, a, c, b], 0, [level])[0].misses == 4


@given(st.lists(st.integers(0, 40), max_size=300))
@settings(max_examples=12)
def test_a_larger_fully_associative_cache_holds_what_a_smaller_one_does(lines):
    addresses = np.array(lines, int) * 64
    misses = [cache.simulate(addresses, 0, [Level(64 * n, 64, n)])[0].misses for n in (1, 8, 64)]
    assert misses == sorted(misses, reverse=True)
    assert misses[-1] == len(set(lines))


def test_every_unit_has_a_cache_of_its_own_and_they_share_the_last():
    levels = [Level(1024, 64, 4, units=8), Level(8192, 64, 8)]
    first, last = cache.simulate(np.zeros(80, int), np.tile(np.arange(8), 10), levels)
    assert first == Counts(80, 72, 8, 8 * 64)
    assert last == Counts(8, 7, 1, 64)


def test_neighbours_share_a_level_in_between():
    levels = [Level(1024, 64, 4, units=8), Level(1024, 64, 4, units=2), Level(8192, 64, 8)]
    found = cache.simulate(np.zeros(8, int), np.arange(8), levels)
    assert [count.misses for count in found] == [8, 2, 1]


def test_one_address_is_read_once():
    found = cache.simulate(np.full(5000, 12345), 0, cache.PRESETS["turing"])
    assert found == (Counts(5000, 4999, 1, 128), Counts(1, 0, 1, 128))


def test_chunks_go_on_where_the_last_one_ended(monkeypatch):
    rng = np.random.default_rng(4)
    levels = [Level(1024, 64, 4, units=8), Level(1024, 64, 4, units=2), Level(8192, 64, 8)]
    addresses, units = rng.integers(0, 2**14, 5000), rng.integers(0, 8, 5000)
    whole = cache.simulate(addresses, units, levels)
    cuts = [0, 0, 1, 1700, 5000]
    pieces = [Accesses(addresses[a:b], units[a:b]) for a, b in zip(cuts, cuts[1:], strict=False)]
    assert cache.simulate_chunks(iter(pieces), levels) == whole
    monkeypatch.setattr(cache, "CHUNK", 999)
    assert cache.simulate(addresses, units, levels) == whole


def test_the_shape_of_pieces_does_not_matter(monkeypatch):
    rng = np.random.default_rng(5)
    addresses = rng.integers(0, 2**14, 3000)
    whole = cache.simulate(addresses, 0, [Level(2048, 32, 4)])
    monkeypatch.setattr(_replacement, "_PIECE", 1)
    assert cache.simulate(addresses, 0, [Level(2048, 32, 4)]) == whole


def test_modes_and_types_do_not_matter():
    rng = np.random.default_rng(6)
    addresses, levels = rng.integers(0, 2**12, 200), [Level(1024, 64, 4)]
    whole = cache.simulate(addresses, 0, levels)
    assert cache.simulate(addresses, 0, levels) == whole
    assert cache.simulate(addresses.astype(np.uint32), np.int8(0), levels) == whole
    with jax.enable_x64(True):
        assert cache.simulate(addresses, 0, levels) == whole


def test_no_reads_count_nothing():
    assert cache.simulate([], 0, cache.PRESETS["rdna"]) == (Counts(0, 0, 0, 0),) * 3
    assert cache.simulate_chunks([], [Level(64, 64, 1)]) == (Counts(0, 0, 0, 0),)
    assert Counts(0, 0, 0, 0).miss_rate == 0


def test_addresses_beyond_32_bits_are_told_apart():
    level = Level(48 * 1024, 128, 24)
    last = 2**31 * 128 * 16 - 1
    # The largest address, the same line, and what has the same lower 32 bits.
    found = cache.simulate([last, last - 127, last - 2**32, last], 0, [level])
    assert found[0].misses == 2
    with pytest.raises(ValueError, match=rf"addresses must be from 0 to {last}, got 0 to {last + 1}"):
        cache.simulate([0, last + 1], 0, [level])


def test_presets_have_the_sizes_that_are_known():
    pascal, rdna = cache.PRESETS["titan_x_pascal"], cache.PRESETS["rdna"]
    assert [level.sets for level in pascal] == [16, 24 * 64]
    assert [level.size_bytes for level in rdna[:2]] == [16 * 1024, 128 * 1024]
    assert [level.units for level in rdna] == [40, 4, 1]


@pytest.mark.parametrize(
    "options, message",
    [
        ((0, 64, 1), "size_bytes must be a whole number of at least 1, got 0"),
        ((1024, 64.0, 1), "line_bytes must be a whole number of at least 1, got 64.0"),
        ((1024, 64, 0), "ways must be a whole number"),
        ((1024, 64, 4, -1), "units must be a whole number"),
        ((1000, 64, 4), "size_bytes must be a multiple of line_bytes times ways, 256 bytes, got 1000"),
    ],
)
def test_levels_that_cannot_be_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Level(*options)


@pytest.mark.parametrize(
    "levels, message",
    [
        ([], "levels must hold at least one level"),
        ([Level(64, 64, 1, 4), Level(64, 64, 1, 3)], r"levels\[1\] has 3 units, which do not divide the 4"),
        ([Level(64, 64, 1), Level(32, 32, 1)], r"levels\[1\] has lines of 32 bytes, no multiple of the 64"),
    ],
)
def test_levels_that_do_not_follow_each_other_are_refused(levels, message):
    with pytest.raises(ValueError, match=message):
        cache.simulate([0], 0, levels)


@pytest.mark.parametrize(
    "addresses, units, message",
    [
        ([[0]], 0, r"addresses must have the shape \(N,\)"),
        ([0, 1], [0], "units the same or none"),
        ([0.5], 0, "addresses must be integers, got float64"),
        ([-1], 0, "addresses must be from 0 to"),
        ([0], 2, "units must be from 0 to 1, got 2 to 2"),
        ([0], -1, "units must be from 0 to 1, got -1"),
    ],
)
def test_reads_that_cannot_be_are_refused(addresses, units, message):
    with pytest.raises(ValueError, match=message):
        cache.simulate(addresses, units, [Level(64, 64, 1, units=2)])


def test_chunks_of_other_shapes_are_refused():
    with pytest.raises(ValueError, match="addresses and units must be as many"):
        cache.simulate_chunks([Accesses(np.arange(3), np.zeros(2, int))], [Level(64, 64, 1)])
