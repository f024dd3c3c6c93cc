"""How many samples a pixel gets: the same for all, or as many as its variance asks for."""

import numpy as np

from sssfit.frames import adaptive, render, scatter
from sssfit.frames.points import Settings
from sssfit.trade.choice import Choice, Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_PILOT, _LEAST, _MOST = 8, 8, 256
# Target variances as shares of the frame's mean variance of a sample.
_TARGETS = (1 / 16, 1 / 32, 1 / 64)


def _prepare(setting: Setting) -> Task:
    _frames.needs_pixels(setting)
    settings = setting.settings
    fixed = (64, 256) if setting.is_quick else (8, 16, 32, 64, 128, 256)
    choices = [c for n in fixed for c in _frames.varied(setting, settings, {f"fixed {n}": {}}, n)]
    return _frames.task(setting, [*choices, *_adaptive(setting, settings)])


def _adaptive(setting: Setting, settings: Settings) -> list[Choice]:
    variance = scatter.variance_of_samples(
        setting.frame, setting.profiles, counts=_PILOT, settings=settings, seed=1
    )
    ids = np.where(setting.mask, np.asarray(setting.frame.profile_id), 0)
    variance = adaptive.smoothed(variance, ids, render.SMOOTHING)
    mean, found = float(np.mean(variance[setting.mask])), []
    for share in _TARGETS[1::2] if setting.is_quick else _TARGETS:
        target = share * mean
        counts = np.where(setting.mask, adaptive.counts(variance, target, _LEAST, _MOST), 0)
        knobs = {"min_spp": _LEAST, "max_spp": _MOST, "target_variance": target}
        name = f"adaptive, mean variance / {round(1 / share)}"
        found.append(_frames.choice(setting, name, knobs, settings, counts))
    return found


GROUP = Group(
    name="counts",
    title="Samples per pixel: the same for all, or from a pilot's variance (the pilot's time left out)",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
    stands_for=(
        "frames.scatter.scatter",
        "frames.scatter.every_profile",
        "frames.scatter.image_and_variance",
        "frames.scatter.variance_of_samples",
        "frames.adaptive.counts",
        "frames.adaptive.smoothed",
    ),
)
