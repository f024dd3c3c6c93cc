"""The groups of approximations, in the order in which they are measured."""

from collections.abc import Sequence

from sssfit.trade.choice import Group
from sssfit.trade.groups import (
    channels,
    controllers,
    convolution,
    counts,
    estimators,
    histories,
    importance,
    inverse_cdfs,
    precision,
    prefilter,
    radius_tables,
    sequences,
    split,
)

#: By name.
GROUPS: dict[str, Group] = {
    module.GROUP.name: module.GROUP
    for module in (
        inverse_cdfs,
        radius_tables,
        precision,
        histories,
        controllers,
        counts,
        sequences,
        importance,
        channels,
        estimators,
        prefilter,
        split,
        convolution,
    )
}


def chosen(names: Sequence[str] | None) -> list[Group]:
    """Groups by their names, in the order in which they are measured.

    Args:
        names: of groups; None for all.

    Raises:
        ValueError: a name is unknown.

    Example:
        >>> [group.name for group in chosen(["split", "precision"])]
        ['precision', 'split']
    """
    unknown = [name for name in names or () if name not in GROUPS]
    if unknown:
        raise ValueError(f"--only must name groups among {', '.join(GROUPS)}, got {unknown[0]!r}")
    return [group for name, group in GROUPS.items() if names is None or name in names]
