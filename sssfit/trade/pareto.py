"""Which choices no other beats in time and error together."""

from collections.abc import Sequence

from sssfit.trade.choice import Group
from sssfit.trade.measure import Row

# Errors of which each is uncertain by a standard error differ when they are apart by so many of both.
_APART = 2.0


def cost(row: Row, of: Group) -> float:
    """What a unit of work costs: nanoseconds, or samples where the group counts these.

    Args:
        row: a choice.
        of: its group.

    Example:
        >>> from sssfit.trade.measure import Row
        >>> from sssfit.trade.registry import GROUPS
        >>> row = Row("controllers", "as", {}, True, 0.1, 0.0, 5.0, 0.02, 32.0, 0.0, 0.0, 0.0)
        >>> cost(row, GROUPS["controllers"])
        32.0
    """
    return row.nanoseconds if of.cost == "time" else row.samples


def beaten_by(row: Row, rows: Sequence[Row], of: Group) -> str:
    """The name of a choice that is faster and more accurate than another, by more than the noise.

    Of two that differ in one of them alone, the one that is better there beats the other if that is no worse
    in the other by more than the noise.

    Args:
        row: the choice.
        rows: of its group.
        of: the group.

    Returns:
        That of the cheapest of those that beat it; "" if none does, and the choice is on the front.

    Example:
        >>> from sssfit.trade.measure import Row
        >>> from sssfit.trade.registry import GROUPS
        >>> slow = Row("split", "slow", {}, False, 0.1, 0.0, 9.0, 0.02, 64.0, 0.0, 0.0, 0.0)
        >>> fast = Row("split", "fast", {}, False, 0.1, 0.0, 3.0, 0.02, 64.0, 0.0, 0.0, 0.0)
        >>> [beaten_by(row, [slow, fast], GROUPS["split"]) for row in (slow, fast)]
        ['fast', '']
    """
    better = [other for other in rows if other is not row and _beats(other, row, of)]
    return min(better, key=lambda other: cost(other, of)).choice if better else ""


def _beats(one: Row, other: Row, of: Group) -> bool:
    is_faster, is_slower = _is_cheaper(one, other, of), _is_cheaper(other, one, of)
    is_nearer, is_farther = _is_nearer(one, other), _is_nearer(other, one)
    return (is_faster and not is_farther) or (is_nearer and not is_slower)


def _is_cheaper(one: Row, other: Row, of: Group) -> bool:
    noise = (one.time_noise**2 + other.time_noise**2) ** 0.5 if of.cost == "time" else 0.0
    return cost(one, of) < cost(other, of) * (1 - noise)


def _is_nearer(one: Row, other: Row) -> bool:
    noise = _APART * (one.error_noise**2 + other.error_noise**2) ** 0.5
    # Where nothing is random, rounding alone makes errors differ a little.
    return one.error + noise < other.error / (1.0 if noise else 1.1)
