"""One number that a paper prints, beside the same number computed here, and whether the two agree.

Each topic has a module `published` whose `rows` yields those of its subject; `sssfit reproduce` shows them.
"""

import math
import re
from decimal import Decimal
from typing import Literal, NamedTuple

Verdict = Literal["reproduced", "differs", "FAILS"]

#: Standard errors of ours within which a printed number may lie; beyond it is no chance.
SIGMAS = 4.0
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


class Row(NamedTuple):
    """A printed number and ours.

    Attributes:
        source: where it is printed, such as "Xie et al. 2020, Eq 21".
        quantity: what it is, with its unit.
        printed: as it is printed, such as "2.5715" or "1.25 %": its digits say how far it was rounded.
        ours: computed, in the printed unit.
        standard_error: of ours, where it is estimated from random samples.
        spread: the range that holds 99 % of single runs, where the printed number is one run's.
        differs: whether it is known not to agree.
        reason: why it differs; or, where it agrees, the reading under which it does.

    Example:
        >>> Row("Xie et al. 2020, Eq 21", "c", "2.5715", 2.5715004).verdict
        'reproduced'
        >>> Row("here", "one half", "0.75", 0.5).verdict
        'FAILS'
    """

    source: str
    quantity: str
    printed: str
    ours: float
    standard_error: float | None = None
    spread: tuple[float, float] | None = None
    differs: bool = False
    reason: str = ""

    @property
    def printed_value(self) -> float:
        """The printed number."""
        return float(self._digits)

    @property
    def rounding(self) -> float:
        """Half a unit in the last printed digit."""
        exponent = Decimal(self._digits).as_tuple().exponent
        assert isinstance(exponent, int)
        return 0.5 * 10.0**exponent

    @property
    def agrees(self) -> bool:
        """Whether the printed number is ours within its rounding and our standard error, or a run of ours."""
        # A number that lies exactly between two printed ones may have been rounded to either.
        allowed = self.rounding * (1 + 1e-9)
        if self.spread is not None:
            low, high = self.spread
            return low - allowed <= self.printed_value <= high + allowed
        return abs(self.ours - self.printed_value) <= allowed + SIGMAS * (self.standard_error or 0.0)

    @property
    def verdict(self) -> Verdict:
        """FAILS where the numbers differ without a reason, agree against expectation, or ours is none."""
        if not math.isfinite(self.ours) or self.agrees == self.differs or (self.differs and not self.reason):
            return "FAILS"
        return "differs" if self.differs else "reproduced"

    @property
    def _digits(self) -> str:
        found = _NUMBER.search(self.printed)
        if found is None:
            raise ValueError(f"printed must hold a number, got {self.printed!r}")
        return found.group()
