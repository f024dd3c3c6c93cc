"""Simulations on disk: what is listed, what the numbers are made of, and the same bytes again."""

import csv
import hashlib
import io
import json

import jax
import numpy as np
import pytest
from PIL import Image

from sssfit.estimators import policies
from sssfit.files.errors import FileError
from sssfit.scenarios import circle, driver, line, measure, writing
from sssfit.scenarios.measure import Target

# Each simulation is a program to compile.
pytestmark = pytest.mark.slow

FRAMES, FIRST, SEEDS = 20, 5, 12
CIRCLE_OPTIONS = {"controller": "as", "alpha": 0.2, "profile": "uniform", "seed": 3}
LINE_OPTIONS = {"controller": "as", "light": "sine", "alpha": None}
CIRCLE_FILES = {"summary.json", "simulation.png", "simulation.npz", "frames.csv"}
X = line.centres(16, 4.0)
INTENSITY = 1 + 0.5 * np.sin(np.arange(8.0))


@pytest.fixture(scope="module")
def one():
    """The circle's statistics and records."""
    policy, target = policies.named("as", target_variance=0.0064), Target(0.0064)
    return writing.simulate(
        circle.uniform(FRAMES), policy, target, seeds=SEEDS, seed=3, start="cold", first=FIRST
    )


@pytest.fixture(scope="module")
def two():
    """The line's statistics and records, under light that varies and that stays."""
    lit, target = line.ramp(X), Target(1e-4)

    def simulated(brightness):
        world = line.world((brightness[:, None] * lit).astype(np.float32), length=4.0, d=0.05)
        return writing.simulate(world, policies.named("as"), target, seeds=3, first=0)

    (found, record), (static, _) = simulated(INTENSITY), simulated(np.ones(8))
    return found, record, {"static": static, "x": X, "light": lit, "intensity": INTENSITY}


def write(out, which, one, two):
    if which == "circle":
        found, record = one
        return writing.write_circle(out, found, record, CIRCLE_OPTIONS)
    found, record, shown = two
    return writing.write_line(out, found, record, LINE_OPTIONS, **shown)


@pytest.fixture(scope="module")
def written(one, two, tmp_path_factory):
    """Of both: the directory and the summary."""
    found = {}
    for which in ("circle", "line"):
        out = tmp_path_factory.mktemp(which) / "out"
        found[which] = out, write(out, which, one, two)
    return found


def contents(directory):
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in directory.rglob("*")}


def table(path):
    with open(path, newline="") as stream:
        header, *rows = csv.reader(stream)
    return dict(zip(header, np.array(rows, float).T, strict=True))


# Simulating


def test_simulated_is_what_the_driver_runs(one):
    found, record = one
    policy = policies.named("as", target_variance=0.0064)
    whole = driver.run(jax.random.key(3), circle.uniform(FRAMES), policy, seeds=SEEDS, start="cold")
    assert all(np.array_equal(a, b) for a, b in zip(record, whole, strict=True))
    expected = measure.collect([whole], circle.uniform(FRAMES), Target(0.0064), first=FIRST)
    assert all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("numbers, kept", [(0, 1), (6 * 20 * 5 - 1, 4), (6 * 20 * 5, 5), (10**9, 12)])
def test_as_many_records_as_make_the_numbers(numbers, kept, one, monkeypatch):
    # Six fields of twenty frames, in chunks of less than what is kept.
    monkeypatch.setattr(writing, "_KEPT_NUMBERS", numbers)
    monkeypatch.setattr(driver, "_CHUNK_NUMBERS", 6 * 20 * 4)
    seen = []
    policy, target = policies.named("as", target_variance=0.0064), Target(0.0064)
    found, record = writing.simulate(
        circle.uniform(FRAMES),
        policy,
        target,
        seeds=SEEDS,
        seed=3,
        start="cold",
        first=FIRST,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert found.seeds == SEEDS and record.count.shape == (kept, FRAMES)
    # Programs for other numbers of seeds may round otherwise.
    assert np.asarray(record.value) == pytest.approx(np.asarray(one[1].value)[:kept], rel=1e-5)
    assert seen == [(0, 12), (4, 12), (8, 12), (12, 12)]


@pytest.mark.parametrize(
    "options, message",
    [
        ({"seeds": 0}, "seeds must be at least 1, got 0"),
        ({"seed": -1}, r"seed must be in \[0, 2\^32\), got -1"),
        ({"seed": 2**32}, r"seed must be in \[0, 2\^32\), got 4294967296"),
        ({"start": "warm"}, "start must be one of cold, disocclusion, got 'warm'"),
        ({"sequence": "halton"}, "sequence must be one of iid, r2, got 'halton'"),
        ({"first": measure.STEADY}, "frames must be more than 50 for figures from frame 51 on, got 20"),
    ],
)
def test_what_cannot_be_simulated(options, message):
    asked = {"seeds": 1, "first": FIRST} | options
    with pytest.raises(ValueError, match=message):
        writing.simulate(circle.uniform(FRAMES), policies.named("fixed"), Target(0.01), **asked)


# Writing


@pytest.mark.parametrize("which, more", [("circle", set()), ("line", {"texels.csv"})])
def test_every_file_is_listed_and_true(which, more, written):
    out, summary = written[which]
    files = contents(out)
    assert set(files) == CIRCLE_FILES | more | {"manifest.json"}
    manifest = json.loads(files["manifest.json"])
    assert manifest["options"] == (CIRCLE_OPTIONS if which == "circle" else LINE_OPTIONS)
    assert manifest["files"] == {
        name: {"sha256": hashlib.sha256(files[name]).hexdigest(), "bytes": len(files[name])}
        for name in CIRCLE_FILES | more
    }
    assert json.loads(files["summary.json"]) == summary


@pytest.mark.parametrize("which", ["circle", "line"])
def test_the_same_bytes_again(which, written, one, two, tmp_path):
    write(tmp_path, which, one, two)
    assert contents(written[which][0]) == contents(tmp_path)


@pytest.mark.parametrize("which, size", [("circle", (1155, 726)), ("line", (1595, 792))])
def test_the_picture_opens(which, size, written):
    with Image.open(written[which][0] / "simulation.png") as picture:
        picture.load()
        assert picture.format == "PNG" and picture.size == size
        # Text, lines and bands, not a blank sheet.
        assert 0.01 < (np.asarray(picture.convert("L")) < 250).mean() < 0.9


def test_summary_of_the_circle(one, written):
    (_, record), (_, summary) = one, written["circle"]
    assert CIRCLE_OPTIONS.items() <= summary.items()
    assert (summary["seeds"], summary["frames"], summary["steady_from_frame"]) == (SEEDS, FRAMES, FIRST + 1)
    counts, values = (np.asarray(a, float)[:, FIRST:] for a in (record.count, record.value))
    by_seed, errors = counts.mean(axis=1), ((values - 1) ** 2).mean(axis=1)
    expected = {
        "steady_mean_count": by_seed.mean(),
        "steady_mean_count_se": by_seed.std(ddof=1) / np.sqrt(SEEDS),
        "mean_count": np.asarray(record.count, float).mean(),
        "oracle_count": (4 / np.pi - 1) / 0.0064,
        "delivered_variance_over_target": errors.mean() / 0.0064,
        "delivered_variance_over_target_se": errors.std(ddof=1) / np.sqrt(SEEDS) / 0.0064,
        "variance_of_moving_mean_over_target": ((np.asarray(record.mean, float)[:, FIRST:] - 1) ** 2).mean()
        / 0.0064,
        "believed_variance_over_target": np.asarray(record.variance, float)[:, FIRST:].mean() / 0.0064,
        "share_at_min": (counts <= 8).mean(),
        "share_at_max": (counts >= 64).mean(),
        "regret": counts.mean() * (1 / counts).mean(),
    }
    # The truth is 1 and the variance is exact, both in float32.
    assert {name: summary[name] for name in expected} == pytest.approx(expected, rel=2e-7)
    quantiles = np.quantile(counts, (0.05, 0.5, 0.95), method="inverted_cdf")
    assert summary["count_quantiles"] == dict(zip(("q05", "q50", "q95"), quantiles, strict=True))
    kept = np.quantile(1 / counts, 0.95, axis=1).mean()
    assert summary["regret_q95"] == pytest.approx(counts.mean() * kept, rel=1e-9)


def test_tables_and_arrays_of_the_circle(one, written):
    (_, record), (out, _) = one, written["circle"]
    frames = table(out / "frames.csv")
    counts = np.asarray(record.count, float)
    assert frames["frame"].tolist() == list(range(1, FRAMES + 1))
    assert frames["mean_count"] == pytest.approx(counts.mean(axis=0), rel=1e-14)
    expected = np.quantile(counts, (0.05, 0.5, 0.95), axis=0, method="inverted_cdf")
    assert [frames[name].tolist() for name in ("count_q05", "count_q50", "count_q95")] == expected.tolist()
    assert frames["mean_result"] == pytest.approx(np.asarray(record.value, float).mean(axis=0), rel=1e-14)
    delivered = circle.SAMPLE_VARIANCE * (1 / counts).mean(axis=0)
    assert frames["delivered_variance"] == pytest.approx(delivered, rel=2e-7)
    with np.load(out / "simulation.npz", allow_pickle=False) as archive:
        for name, leaf in record._asdict().items():
            assert np.array_equal(archive[f"record_{name}"], leaf)
        assert np.array_equal(archive["count_by_seed"], counts)
        assert archive["histogram"].sum(axis=1).tolist() == [SEEDS] * FRAMES


def test_summary_and_tables_of_the_line(two, written):
    (_, record, shown), (out, summary) = two, written["line"]
    assert LINE_OPTIONS.items() <= summary.items() and (summary["seeds"], summary["frames"]) == (3, 8)
    counts, values = (np.asarray(a, float) for a in (record.count, record.value))
    texels, frames = table(out / "texels.csv"), table(out / "frames.csv")
    assert (texels["x_mm"] == X).all() and (texels["irradiance"] == shown["light"]).all()
    assert (frames["intensity"] == INTENSITY).all() and list(frames)[0] == "frame"
    for axis, columns in (((0, 1), texels), ((0, 2), frames)):
        assert columns["mean_count"] == pytest.approx(counts.mean(axis=axis), rel=1e-13)
        assert columns["mean_result"] == pytest.approx(values.mean(axis=axis), rel=1e-13)
    with np.load(out / "simulation.npz") as archive:
        truth, variance = archive["truth"], archive["sample_variance"]
        assert (archive["x_mm"] == X).all()
    errors = ((values - truth) ** 2).mean(axis=(1, 2))
    ideal = np.clip(variance / 1e-4, 8, 64)
    expected = {
        "mean_count": counts.mean(),
        "static_ratio": counts.mean() / shown["static"].count.mean(),
        "image_rmse": np.sqrt(errors.mean()),
        "image_rmse_se": errors.std(ddof=1) / np.sqrt(3) / (2 * np.sqrt(errors.mean())),
        "static_image_rmse": np.sqrt(shown["static"].squared_error.mean()),
        "oracle_count": ideal.mean(),
        "count_over_oracle": counts.mean() / ideal.mean(),
    }
    assert {name: summary[name] for name in expected} == pytest.approx(expected, rel=1e-12)
    assert texels["oracle_count"] == pytest.approx(ideal.mean(axis=0), rel=1e-13)
    assert texels["delivered_variance"] == pytest.approx((variance / counts).mean(axis=(0, 1)), rel=1e-13)


def test_points_of_low_discrepancy_have_no_regret(tmp_path):
    policy, target = policies.named("fixed"), Target(0.0064)
    found, record = writing.simulate(
        circle.uniform(FRAMES), policy, target, seeds=SEEDS, sequence="r2", first=FIRST
    )
    summary = writing.write_circle(tmp_path, found, record, CIRCLE_OPTIONS)
    assert np.isnan(summary["regret"]) and np.isnan(summary["regret_q95"])
    errors = (np.asarray(record.value, float) - 1) ** 2
    assert table(tmp_path / "frames.csv")["delivered_variance"] == pytest.approx(
        errors.mean(axis=0), rel=1e-12
    )
    assert summary["delivered_variance_over_target"] == pytest.approx(
        errors[:, FIRST:].mean() / 0.0064, rel=1e-12
    )


def test_one_seed_has_no_errors(one, tmp_path):
    found, record = one
    first = jax.tree.map(lambda leaf: leaf[:1], record)
    alone = measure.collect([first], circle.uniform(FRAMES), Target(0.0064), first=FIRST)
    summary = writing.write_circle(tmp_path, alone, first, CIRCLE_OPTIONS)
    assert np.isnan(summary["steady_mean_count_se"])
    assert json.loads((tmp_path / "summary.json").read_text())["steady_mean_count_se"] == "nan"


def test_a_failure_leaves_earlier_outputs(written, one, two, monkeypatch):
    def failing(arrays):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writing, "npz_bytes", failing)
    for which, (out, _) in written.items():
        before = contents(out)
        with pytest.raises(FileError, match="the disk is full, earlier outputs are untouched"):
            write(out, which, one, two)
        assert contents(out) == before


def test_pictures_are_drawn_without_a_display(one, tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "TkAgg")
    monkeypatch.delenv("DISPLAY", raising=False)
    found, record = one
    writing.write_circle(tmp_path, found, record, CIRCLE_OPTIONS)
    assert Image.open(io.BytesIO((tmp_path / "simulation.png").read_bytes())).format == "PNG"
