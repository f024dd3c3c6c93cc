"""What a scene needs: verdicts on given errors, and scenes that need nothing."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from sssfit.frames import procedural
from sssfit.trade.choice import CannotMeasure
from sssfit.trade.setting import procedural_setting
from sssfit.trade.studies import needs
from sssfit.trade.studies.needs import Trials, Way

SETTING = procedural_setting(is_quick=True)


def measured(errors, seconds=(1.0, 1.0, 1.0)):
    return Trials(np.asarray(errors), np.asarray(seconds))


def row(with_it, without, is_default=True):
    return needs._row(1, "feature", is_default, measured(*with_it), measured(*without))


def test_losses_are_those_of_pairs():
    # Seeds differ far more than the feature does.
    seeds = np.array([0.1, 0.2, 0.3, 0.4])
    found = row([seeds, [2.0, 2.0, 2.0]], [seeds + [0.01, 0.012, 0.011, 0.011], [1.0, 1.0, 1.0]])
    assert found["loss"] == pytest.approx(0.011) and found["time with / without"] == 2
    interval = stats.ttest_rel(seeds + [0.01, 0.012, 0.011, 0.011], seeds).confidence_interval(0.95)
    assert found["loss, ±"] == pytest.approx((interval.high - interval.low) / 2)
    assert found["verdict"] == "can be compiled away: a loss of 4.4%, at most 4.9%"


@pytest.mark.parametrize(
    "without, is_default, verdict",
    [
        ([0.1, 0.1, 0.1, 0.1], True, "can be compiled away: a loss of 0.0%, at most 0.0%"),
        ([0.2, 0.2, 0.2, 0.2], True, "without: 2 x the error, 1 x the time"),
        ([0.102, 0.102, 0.102, 0.102], True, "can be compiled away: a loss of 2.0%, at most 2.0%"),
        ([0.05, 0.15, 0.05, 0.18], True, "undecided: a loss of 7% ± 107%"),
        ([0.05, 0.15, 0.05, 0.18], False, "undecided: a loss of 7% ± 107%"),
        ([0.05, 0.05, 0.05, 0.05], True, "can be compiled away: 50% less error without"),
        ([0.2, 0.2, 0.2, 0.2], False, "buys 50% of the error for 1 x the time"),
        ([0.1, 0.1, 0.1, 0.1], False, "buys nothing here"),
        ([0.05, 0.05, 0.05, 0.05], False, "makes the error larger here"),
    ],
)
def test_verdicts(without, is_default, verdict):
    assert row([[0.1] * 4], [without], is_default)["verdict"] == verdict


def test_noise_alone_is_no_loss():
    random = np.random.default_rng(0)
    trials = 2000
    needed = sum(
        row([random.normal(1, 0.1, 4)], [random.normal(1, 0.1, 4)])["verdict"].startswith("without")
        for _ in range(trials)
    )
    # Beyond the upper end of a 95 % interval; four standard errors.
    assert abs(needed / trials - 0.025) < 4 * np.sqrt(0.025 * 0.975 / trials)


def test_features_are_left_out_together():
    distance, ids, radii, shapes = needs.features(SETTING)[:4]
    base = SETTING.settings
    assert needs.without_all([distance, radii]) == Way(base._replace(distance="plane", channels="widest"))
    assert needs.without_all([ids, shapes]) == Way(base, tells_ids=False, has_shapes=False)


def test_without_normals_there_is_no_tangent_plane():
    bare = dataclasses.replace(SETTING, frame=SETTING.frame._replace(normal=None))
    names = [[feature.name for feature in needs.features(one)] for one in (SETTING, bare)]
    assert names[0] == [*names[1], "tangent plane"]


def test_a_frame_without_profiles_needs_nothing_to_be_measured():
    empty = dataclasses.replace(SETTING, profiles={1: None, 2: None})
    with pytest.raises(CannotMeasure, match="the frame has no pixel with a profile"):
        needs.STUDY.measure(empty, 3, lambda text: None)


@pytest.mark.slow
def test_a_profile_alike_in_its_channels_needs_no_shapes_and_a_bright_neighbour_needs_ids(monkeypatch):
    """A board behind the edge of a ball: distances in the plane alone do not tell one from the other."""
    features = needs.features(SETTING)

    def two(setting):
        plane = setting.settings._replace(distance="plane")
        way = Way(plane)
        return [
            needs.Feature("profile ids", way, way._replace(tells_ids=False), True),
            needs.Feature("per-channel shapes", way, way._replace(has_shapes=False), True),
        ]

    assert [feature.name for feature in features[1:4:2]] == [feature.name for feature in two(SETTING)]
    monkeypatch.setattr(needs, "features", two)
    frame = procedural.frame(width=160, height=90)
    bright = np.where(np.asarray(frame.profile_id)[..., None] == 2, 50.0, np.asarray(frame.irradiance))
    setting = dataclasses.replace(
        SETTING, frame=frame._replace(irradiance=bright), profiles={1: np.full(3, 2.0), 2: None}
    )
    found = needs.STUDY.measure(setting, 3, lambda text: None)
    ids, shapes, both = found.rows
    assert ids["verdict"].startswith("without: ") and ids["error without"] > 5 * ids["error with"]
    assert shapes["loss"] == pytest.approx(0, abs=1e-6)
    assert shapes["verdict"].startswith("can be compiled away: a loss of 0.0%")
    # What loses least goes first.
    assert both["feature"] == "per-channel shapes + profile ids"
    assert found.sentences[0].startswith("profile 1: per-channel shapes can be compiled away: a loss of 0.0%")
    assert needs.STUDY.picture(found)[1:4] == b"PNG"
