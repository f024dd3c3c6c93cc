"""Blurs along two axes in place of the radial profile: how many taps, and of which kernel."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from sssfit.trade.choice import Choice, Group, Task
from sssfit.trade.groups import _blur, _board, _frames, _kernels
from sssfit.trade.groups._kernels import Kernels
from sssfit.trade.setting import Setting

_TAPS = 25


def _prepare(setting: Setting) -> Task:
    flat, _ = _board.flat(setting.is_quick)
    kernels = _all(np.asarray(flat.profiles[1]), setting.is_quick)
    made = (_choice(flat, name, knobs, given) for name, knobs, given in kernels)
    return Task(flat.pixels, tuple(made), f"{_board.note(flat)}, taps read linearly")


def _all(d: np.ndarray, is_quick: bool) -> Iterator[tuple[str, dict[str, Any], Kernels]]:
    """Names, what is set and kernels of all choices."""
    of_burley = {"kernel": "burley", "taps": _TAPS}
    for taps in (9, _TAPS) if is_quick else (9, 17, _TAPS, 33, 49):
        yield f"{taps} taps", of_burley | {"taps": taps}, _kernels.shared(d, taps)
    for reach in (8,) if is_quick else (4, 8):
        knobs = of_burley | {"reach_d": reach}
        yield f"{_TAPS} taps to {reach} d", knobs, _kernels.shared(d, _TAPS, reach * np.max(d))
    for taps in (9,) if is_quick else (9, _TAPS):
        knobs = of_burley | {"taps": taps, "channels": "apart"}
        yield f"{taps} taps, channels apart", knobs, _kernels.apart(d, taps)
    # Its width takes a fit that compiles for seconds.
    if not is_quick:
        yield f"{_TAPS} taps, falloff", {"kernel": "falloff", "taps": _TAPS}, _kernels.falloff(d, _TAPS)
    for number in (4,) if is_quick else (1, 2, 4):
        for to in ("radial density",) if is_quick else ("profile", "radial density"):
            taps = number * _kernels.GAUSSIAN_TAPS
            knobs = {"kernel": "gaussians", "taps": taps, "fitted_to": to}
            name = f"{number} Gaussian{'s' if number > 1 else ''}, {to}"
            yield name, knobs, _kernels.gaussians(d, number, to)


def _choice(flat: Setting, name: str, knobs: dict[str, Any], kernels: Kernels) -> Choice:
    image = flat.frame.irradiance

    def run() -> np.ndarray:
        return np.asarray(_blur.blurred(image, kernels, _board.WIDTH / len(image)))

    # Both passes of each tap read two pixels of three numbers, and write one.
    number, taps, _ = kernels.offsets.shape
    return Choice(
        name=name,
        knobs=knobs,
        run=run,
        error=lambda: _frames.error_of([run()], flat),
        bytes_moved=2 * 4 * 3 * number * (2 * taps + 1),
        is_default=name == f"{_TAPS} taps",
    )


GROUP = Group(
    name="separable",
    title="A flat surface: blurs along rows and columns in place of the radial profile",
    unit="pixel",
    error=_frames.ERROR,
    reference="the convolution in float64",
    prepare=_prepare,
    beside_the_front="The default holds 99.7 % of the widest channel's light, where 8 d hold 95 % and 4 d "
    "80 %; and kernels of each channel's own take three reads of a tap where a GPU makes one.",
    stands_for=(
        "profiles.separable.burley_kernel",
        "profiles.separable.falloff_kernel",
        "profiles.separable.kernel_offsets",
        "tables.kernel.burley_kernel_table",
        "tables.kernel.falloff_kernel_table",
        "fitting.gaussian_sum.fit",
        "fitting.gaussian_sum.fit_profile",
        "fitting.separable_to_burley.fit_many",
    ),
)
