"""Convolution by FFT beside sampling, where both are right: a flat surface seen from straight above."""

from sssfit.frames.points import Settings
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _board, _frames
from sssfit.trade.setting import Setting

_SAMPLES, _QUICK_SAMPLES = (16, 64, 256), (64,)


def _prepare(setting: Setting) -> Task:
    flat, convolved = _board.flat(setting.is_quick)
    settings = Settings(distance="plane")
    sampled = [
        _frames.choice(flat, f"{n} samples", {"method": "scatter", "spp": n}, settings, n)
        for n in (_QUICK_SAMPLES if setting.is_quick else _SAMPLES)
    ]
    return Task(flat.pixels, (convolved, *sampled), _board.note(flat))


GROUP = Group(
    name="convolution",
    title="A flat surface: convolution by FFT, or samples",
    unit="pixel",
    error=_frames.ERROR,
    reference="the convolution in float64, which is right to some 1e-13 of the light",
    prepare=_prepare,
    stands_for=("frames.exact.convolve",),
)
