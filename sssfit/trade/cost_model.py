"""Seconds of a frame from what its passes demand: the dissertation's cost, with this machine's own weights.

    T = a passes + b pixels of frames + c sampled pixels + sum over techniques of w samples drawn
        + e bytes from the second cache + f bytes from memory

is equations 3.1 to 3.5 with every O(n) written out: a, b and c are the O(n) of 3.1 and 3.2, w the computing
weight of a technique in 3.2 with the O(m') of 3.3 and the O(d) of 3.5, and the bytes the R(d) of 3.5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sssfit.fitting import non_negative
from sssfit.trade.demands import Demand

#: Of what each weight is the cost, in the order of `Model.weights`; techniques come after.
SHARED = ("passes", "frame_pixels", "pixels", "from_second", "from_memory")


@dataclass(frozen=True)
class Model:
    """What each demand costs on a machine.

    Attributes:
        weights: seconds by the name of a demand (see `SHARED`): for a pass, a pixel of a frame, a sampled
            pixel, a byte from the second level of caches and a byte from memory. All >= 0.
        techniques: seconds for a drawn sample by the name of a technique, >= 0.
    """

    weights: dict[str, float]
    techniques: dict[str, float]

    def seconds(self, demand: Demand, technique: str) -> float:
        """The time of a frame.

        Args:
            demand: of its passes.
            technique: by which its samples are drawn.

        Returns:
            Seconds, >= 0.

        Raises:
            KeyError: nothing was fitted for the technique.

        Example:
            >>> model = Model({name: 0.0 for name in SHARED} | {"passes": 0.002}, {"plane": 2e-9})
            >>> model.seconds(Demand(1, 0, 0, 0, 1e6, 0, 0), "plane")
            0.004
        """
        shared = sum(self.weights[name] * getattr(demand, name) for name in SHARED)
        return float(shared + self.techniques[technique] * demand.drawn)


def fit(demands: Sequence[Demand], techniques: Sequence[str], seconds: Sequence[float]) -> Model:
    """Find the weights whose times are nearest to what was measured.

    Args:
        demands: of frames, N.
        techniques: by which each was sampled, N names.
        seconds: that each took, N numbers > 0.

    Returns:
        The weights, none negative, with the least sum of squared relative errors; of demands that all points
        have alike, and of those that rise together, some are 0.

    Raises:
        ValueError: lengths that differ, no points, or a time that is not above 0.

    Source: Xie, dissertation, 2021, Eq 3.1 to 3.5; non-negative least squares by Lawson and Hanson, 1974.

    Example:
        >>> demands = [Demand(1, 100, 10, n, n, 0, 0) for n in (10, 1000, 2000)]
        >>> model = fit(demands, ["plane"] * 3, [1.01, 2.0, 3.0])
        >>> round(model.techniques["plane"], 9)
        0.001
    """
    if not len(demands) == len(techniques) == len(seconds) > 0:
        raise ValueError(
            "demands, techniques and seconds must be as many and at least one, "
            f"got {len(demands)}, {len(techniques)} and {len(seconds)}"
        )
    times = np.asarray(seconds, float)
    if not np.all(times > 0):
        raise ValueError(f"seconds must be above 0, got {times.min()}")
    names = list(dict.fromkeys(techniques))
    table = np.array(
        [
            [getattr(demand, name) for name in SHARED]
            + [demand.drawn * (technique == name) for name in names]
            for demand, technique in zip(demands, techniques, strict=True)
        ],
        float,
    )
    # What is nearest to 1 is a share of what was measured.
    weights = non_negative.least_squares(table / times[:, None], np.ones(len(times)))
    shared = {str(name): float(weight) for name, weight in zip(SHARED, weights, strict=False)}
    return Model(shared, dict(zip(names, map(float, weights[len(SHARED) :]), strict=True)))
