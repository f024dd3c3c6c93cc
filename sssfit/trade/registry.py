"""The groups of approximations and the studies, in the order in which they are measured."""

from collections.abc import Sequence

from sssfit.trade.choice import Group
from sssfit.trade.groups import (
    accumulation,
    channels,
    controllers,
    convolution,
    counts,
    estimators,
    falloff_tables,
    histories,
    importance,
    inverse_cdfs,
    lookup_tables,
    precision,
    prefilter,
    radius_tables,
    recursions,
    reprojection,
    separable,
    sequences,
    split,
)
from sssfit.trade.studies import cost, needs
from sssfit.trade.study import Study

#: By name.
GROUPS: dict[str, Group] = {
    group.name: group
    for group in (
        inverse_cdfs.GROUP,
        radius_tables.GROUP,
        *lookup_tables.GROUPS,
        falloff_tables.GROUP,
        precision.GROUP,
        histories.GROUP,
        recursions.GROUP,
        controllers.GROUP,
        counts.GROUP,
        sequences.GROUP,
        importance.GROUP,
        channels.GROUP,
        estimators.GROUP,
        prefilter.GROUP,
        split.GROUP,
        convolution.GROUP,
        separable.GROUP,
        reprojection.GROUP,
        accumulation.GROUP,
    )
}


#: By name; measured after the groups.
STUDIES: dict[str, Study] = {module.STUDY.name: module.STUDY for module in (cost, needs)}


def chosen(names: Sequence[str] | None) -> tuple[list[Group], list[Study]]:
    """Groups and studies by their names, in the order in which they are measured.

    Args:
        names: of groups and studies; None for all.

    Raises:
        ValueError: a name is unknown.

    Example:
        >>> groups, studies = chosen(["split", "cost_model", "precision"])
        >>> [each.name for each in (*groups, *studies)]
        ['precision', 'split', 'cost_model']
    """
    known = (*GROUPS, *STUDIES)
    unknown = [name for name in names or () if name not in known]
    if unknown:
        raise ValueError(f"--only must name groups or studies among {', '.join(known)}, got {unknown[0]!r}")
    groups = [group for name, group in GROUPS.items() if names is None or name in names]
    return groups, [study for name, study in STUDIES.items() if names is None or name in names]
